"""FMUs that count their own time in hours, minutes or days: all outside of them counts seconds."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
from c_fmu_for_tests import write_fmu
from case_for_tests import edit
from exchange_for_tests import build, settings
from kinds_fmu import build_kinds_fmu, closed_form, kinds_settings

from simulation import FmuModel, InputError, load_case
from simulation.fmi.description import read_description
from simulation.fmi.own_time import own_unit_s
from studies.calibration.state_equations.states import StateSignals, WatchedModel, watching_states
from studies.doctor.begin import look_at_begin
from studies.new.choice import choose_times

DECAY = Path(__file__).with_name("decay.c")
CLOCK = '<ScalarVariable name="t" valueReference="9" causality="independent"><Real{}/></ScalarVariable>'
LENGTHS = {"h": 3600.0, "min": 60.0, "d": 86400.0, "hours": 3600.0, "ms": 1e-3, "s": 1.0}


def declare(folder: Path, unit: str, *, defined: str = "", experiment: str = "") -> None:
    """Let the FMU of a case declare the unit of its time; its rate is then by this unit, too."""
    text = DECAY.with_suffix(".xml").read_text()
    if unit in LENGTHS:
        text = text.replace('unit="1/s"', f'unit="1/{unit}"').replace('unit="K/s"', f'unit="K/{unit}"')
    said = f' unit="{unit}"' if unit else ""
    text = text.replace("</ModelVariables>", CLOCK.format(said) + "</ModelVariables>")
    text = text.replace("</UnitDefinitions>", f"{defined}</UnitDefinitions>{experiment}")
    write_fmu(folder / "decay.fmu", text, DECAY)


def answers(folder: Path) -> np.ndarray:
    with load_case(folder).open_model() as model:
        return model.simulate(np.array([[1e-4, 0.0], [3e-5, 0.0]])).y


@pytest.mark.parametrize("unit", ["h", "min", "d", "hours", "s"])
def test_the_declared_unit_changes_no_answer(decay_case: Path, unit: str):
    before = load_case(decay_case)
    plain = answers(decay_case)
    declare(decay_case, unit)
    case = load_case(decay_case)
    said = [f"counts in units of {LENGTHS[unit]:g} s; all times here are in seconds or days"]
    assert [one.found for one in look_at_begin(case)] == said * (unit != "s")
    np.testing.assert_allclose(answers(decay_case), plain, rtol=1e-12)
    np.testing.assert_array_equal(case.scenario.time_communication, before.scenario.time_communication)
    assert case.settings.time_unit_s == LENGTHS[unit]


def test_the_case_says_it_where_the_fmu_does_not(decay_case: Path):
    plain = answers(decay_case)
    declare(decay_case, "")
    # As of an FMU that counts minutes: units are those of its equations, its rate is by the minute.
    edit(
        decay_case,
        ("[time]", '[time]\nfmu_unit = "min"'),
        ('unit = "K/s"', 'unit = "K/s"\nfmu_unit = "K/min"'),
    )
    fmu = decay_case / "decay.fmu"
    text = DECAY.with_suffix(".xml").read_text().replace(' unit="K/s"', "").replace('"1/s"', '"1/min"')
    write_fmu(fmu, text, DECAY)
    np.testing.assert_allclose(answers(decay_case), plain, rtol=1e-12)
    said = load_case(decay_case)
    edit(decay_case, ('fmu_unit = "min"\n', ""))
    # What was simulated with another unit is not read again.
    assert load_case(decay_case).model_digest != said.model_digest


def test_a_unit_that_the_fmu_defines_is_its_own(decay_case: Path):
    declare(decay_case, "tick", defined='<Unit name="tick"><BaseUnit s="1" factor="0.5"/></Unit>')
    assert load_case(decay_case).settings.time_unit_s == 0.5


@pytest.mark.parametrize(
    ("unit", "defined"),
    [
        ("rad", '<Unit name="rad"><BaseUnit rad="1"/></Unit>'),
        ("m", ""),
        ("1", ""),
        ("tick", ""),
        # An hour of one second: its exporter forgot the factor, or means ticks.
        ("h", '<Unit name="h"><BaseUnit s="1"/></Unit>'),
        ("s-1", ""),
    ],
)
def test_a_unit_that_is_no_time_is_refused_in_one_line(decay_case: Path, unit: str, defined: str):
    declare(decay_case, unit, defined=defined)
    said = f"decay.fmu counts its independent variable in '{unit}', which is no clear unit of time; say in"
    with pytest.raises(InputError, match=re.escape(said)) as error:
        load_case(decay_case)
    assert str(error.value).startswith(f"{decay_case / 'case.toml'}: ")
    assert "\n" not in str(error.value)
    edit(decay_case, ("[time]", '[time]\nfmu_unit = "min"'))
    assert load_case(decay_case).settings.time_unit_s == 60.0


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("min", "time.fmu_unit = 'min' contradicts decay.fmu, whose time counts in 'h'; drop it"),
        ("K", "time.fmu_unit = 'K' is no unit of time; write"),
        ("fortnight", "time.fmu_unit = 'fortnight' is no unit of time; write"),
    ],
)
def test_a_unit_that_contradicts_or_is_no_time_is_refused(decay_case: Path, key: str, said: str):
    declare(decay_case, "h")
    edit(decay_case, ("[time]", f'[time]\nfmu_unit = "{key}"'))
    with pytest.raises(InputError, match=re.escape(said)):
        load_case(decay_case)
    edit(decay_case, (f'"{key}"', '"h"'))
    load_case(decay_case)


def test_a_failure_is_said_in_seconds(decay_case: Path):
    declare(decay_case, "min")
    # The FMU gives up from 30,000 of its minutes on.
    edit(decay_case, ("window_d = [0.25, 0.75]", "window_d = [0, 0.5]"))
    case = load_case(decay_case)
    longer = np.arange(0.0, 3_000_001.0, 60_000.0)
    scenario = dataclasses.replace(case.scenario, time_communication=longer, inputs=np.zeros((50, 1)))
    chosen = dataclasses.replace(case.settings, scenario=dataclasses.replace(scenario, output_every=1))
    with chosen.open() as model:
        (reason,) = model.simulate(np.array([[1e-6, 1.0]])).failures
    assert reason.startswith("fmi2DoStep returned fmi2Error at 1.8e+06 s")


def test_minutes_of_fmi_3(tmp_path: Path):
    fmu = build_kinds_fmu(tmp_path, fmi=3)
    plain = kinds_settings(fmu)
    minutes = dataclasses.replace(plain, time_unit_s=60.0)
    by_minute = dataclasses.replace(plain.scenario, inputs=60.0 * plain.scenario.inputs)
    k, x0 = 1e-5, 310.0
    with dataclasses.replace(minutes, scenario=by_minute).open() as model:
        answer = model.simulate(np.array([[60.0 * k, x0]]))
    # Beside x, its output has the 2 of `size`.
    np.testing.assert_allclose(answer.y[0, :, 0], closed_form(plain, k, x0) + 2.0, rtol=1e-10)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_hours_in_model_exchange(tmp_path: Path, version: str):
    fmu, edges = build(tmp_path, version), 3600.0 * np.arange(21) * 10.0
    chosen = dataclasses.replace(settings(fmu, "TRIANGLE", edges=edges), time_unit_s=3600.0)
    with FmuModel(chosen) as model:
        answer = model.simulate(np.array([[7.0, 0.0]]))
    # It turns every seven of its hours, by time events.
    turns = np.floor(edges / 3600.0 / 7.0)
    rest = edges / 3600.0 - 7.0 * turns
    np.testing.assert_allclose(answer.y[0, :, 0], np.where(turns % 2 == 0, rest, 7.0 - rest), atol=1e-9)
    with FmuModel(dataclasses.replace(chosen, fixed={"mode": 5.0})) as model:
        (reason,) = model.simulate(np.array([[7.0, 0.0]])).failures
    assert re.search(r"at 360000 s", reason)


def test_slopes_of_states_are_by_the_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of the wall, whose binary counts what its description calls minutes here."""
    repository = Path(__file__).parents[2]
    text = (repository / "fmus" / "wall" / "case.toml").read_text()
    text = text.replace("../../data/wall", str(repository / "data" / "wall"))
    text = text.replace('"Wall.fmu"', f'"{repository / "fmus" / "wall" / "Wall.fmu"}"')
    (tmp_path / "case.toml").write_text(text)
    case = load_case(tmp_path)
    case = dataclasses.replace(case, settings=dataclasses.replace(case.settings, time_unit_s=60.0))
    row = case.parameter_space.expected[None]
    with watching_states(case).open_model() as inner:
        model = WatchedModel(inner, StateSignals.of(case))
        model.simulate(row)
        seen = model.seen(row)
        middle = 0.5 * (seen.slope[0, 1:] + seen.slope[0, :-1])
        moved = np.diff(seen.x[0], axis=0) / np.diff(model.watched_time)[:, None]
    # A slope at an output is that of a moment; over all of them both say the same.
    assert np.corrcoef(middle[:, 1], moved[:, 1])[0, 1] > 0.95
    assert np.polyfit(middle[:, 1], moved[:, 1], 1)[0] == pytest.approx(1.0, abs=0.1)


def test_the_default_experiment_counts_in_the_same_unit(decay_case: Path):
    said = '<DefaultExperiment startTime="24" stopTime="72" stepSize="0.25" tolerance="1e-5"/>'
    declare(decay_case, "h", experiment=said)
    fmu = read_description(decay_case / "decay.fmu")
    experiment = fmu.default_experiment
    assert (experiment.start_s, experiment.stop_s, experiment.step_s) == (86400.0, 259200.0, 900.0)
    assert experiment.tolerance == 1e-5
    times = choose_times(fmu)
    assert (times.start_s, times.stop_s, times.step_s, times.unit.symbol) == (86400.0, 259200.0, 900.0, "d")
    assert math.isclose(own_unit_s(fmu.variables, fmu.units, None, "decay.fmu"), 3600.0)


@pytest.mark.parametrize(
    ("unit", "line"),
    [
        ("h", 'fmu_unit = "h" '),
        ("rad", 'fmu_unit = "s"                # EDIT: '),
        ("", '# fmu_unit = "h" '),
    ],
)
def test_a_new_case_says_the_unit(
    decay_case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unit: str, line: str
):
    from studies.cli import main

    declare(decay_case, unit)
    monkeypatch.chdir(tmp_path)
    assert main(["new", str(decay_case / "decay.fmu"), "--to", "made", "-q"]) == 0
    assert f"\n{line}" in (tmp_path / "made" / "case.toml").read_text()
