"""What the doctor must not hold against a case: experiments, wide bounds, slow rows; and what it names."""

import re
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest
from bad_cases_for_tests import make_bad_case
from project_for_tests import Answer, Run, add_case, edit
from two_rooms_for_tests import TWO_ROOMS, two_rooms_with

from simulation.arrays import FloatArray
from simulation.case import Case, load_case
from simulation.fmi.variable import Interface
from simulation.pool.execution import FIRST_LIMIT_S, ExecutionPolicy
from simulation.samples import Samples
from simulation.trajectories import Trajectories
from studies.doctor import Diagnosis, examine
from studies.doctor.answers import N_COVERAGE, coverage_points, look_at_coverage, look_at_estimates
from studies.doctor.asking import Asked
from studies.doctor.budget import TimeBudget
from studies.doctor.declared import look_at_data, look_at_declaration, look_at_number_of_values
from studies.doctor.mixups import better_inputs, better_outputs, input_mixups
from studies.paths import ProjectPaths
from studies.profile import load_profile
from studies.task import Task
from studies.words.console import Console

NO_SUN = 'inputs = [{ name = "sun", sum = { sun_W_m2 = 0.0 } }]'


def levels(answer: Answer) -> dict[str, str]:
    return {one["what"]: one["level"] for one in answer.document["findings"]}


def examined(project: Path, file: Path, **limits: Any) -> Diagnosis:
    paths, console = ProjectPaths(project), Console(quiet=True)
    task = Task(load_case(file), load_profile("smoke"), paths, console, 1, "x", "x")
    return examine(task, **limits)


# Experiments


def two_rooms(project: Path, *names: str, dark: tuple[str, ...]) -> None:
    """Write the two rooms with some experiments, some of them without sun, into a project."""
    add_case(project, "two-rooms")
    file = project / "fmus" / "two-rooms" / "case.toml"
    head, *tables = file.read_text(encoding="utf-8").split("[[experiments]]")
    by_name = {table.split('"')[1]: table for table in tables}
    parts = [by_name[name].rstrip() + f"\n{NO_SUN}" * (name in dark) + "\n\n" for name in names]
    head = head.replace('column = "sun_W_m2"', "sum = { sun_W_m2 = 1.0 }")
    file.write_text("[[experiments]]".join([head, *parts]), encoding="utf-8")


@pytest.mark.slow
def test_a_parameter_may_act_in_one_experiment_alone(project: Path, studies: Run) -> None:
    # Without sun the windows' areas have no effect.
    two_rooms(project, "cooling", "heater-1", dark=("cooling",))
    answer = studies("check", "two-rooms", "--profile", "smoke", "--json")
    assert answer.code == 0, answer.out
    assert levels(answer)["every parameter moves an output"] == "ok"
    assert not any(what.endswith(": every parameter moves an output") for what in levels(answer))


@pytest.mark.slow
def test_what_acts_in_a_held_out_experiment_alone_is_named(project: Path, studies: Run) -> None:
    two_rooms(project, "cooling", "held-out", dark=("cooling",))
    answer = studies("check", "two-rooms", "--profile", "smoke", "--json")
    assert answer.code == 1
    (line,) = [one for one in answer.document["findings"] if one["level"] == "fail"]
    assert (line["what"], line["found"]) == ("every parameter moves an output", "no effect: A1, A2")


@pytest.mark.parametrize(("names", "level"), [(("cooling",), "warn"), (("cooling", "heater-1"), "ok")])
def test_values_are_counted_over_all_experiments(tmp_path: Path, names: tuple[str, ...], level: str) -> None:
    two_rooms_with(tmp_path, *names)
    file, end = tmp_path / "case.toml", 3 / 96
    for begin in (0.5, 2.5):
        text = file.read_text(encoding="utf-8")
        window = re.sub(rf"(?<=window_d = \[){begin}, \S+(?=\])", f"{begin}, {begin + end}", text)
        file.write_text(window, encoding="utf-8")
    case = load_case(file)
    found = look_at_number_of_values(case)
    # Four samples of two outputs each, and one start of the wall each.
    assert found.level == level
    assert found.found.endswith(f"{8 * len(names)} measured values for {8 + len(names)} parameters")
    for one in case.experiments:
        (data,) = [line for line in look_at_data(one) if line.what == "data"]
        assert "cannot be found from" not in data.remedy


# Bounds


def make_wide_case(project: Path, lower: str, upper: str) -> Path:
    """Make a case in which nothing matters in the middle of the bounds of k: all has decayed there."""
    file = make_bad_case(project, "GOOD")
    text = file.read_text(encoding="utf-8")
    head, rest = text.split('[[parameters]]\nname = "trouble"')
    text = head + rest[rest.index("[fixed]") :]
    text = re.sub(r"^estimate = .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^scale = .*\n", "", text, flags=re.MULTILINE)
    begin, k = text.split('name = "k"')
    for key, value in (("lower", lower), ("upper", upper)):
        k = re.sub(rf"^{key} = .*$", f"{key} = {value}", k, count=1, flags=re.MULTILINE)
    text = f'{begin}name = "k"\nscale = "log"{k}'
    text = re.sub(r"^window_s = .*$", "window_s = [3600, 36000]\nstart_s = 0", text, flags=re.MULTILINE)
    text = re.sub(r"^window_d = .*$", "window_s = [3600, 36000]\nstart_s = 0", text, flags=re.MULTILINE)
    file.write_text(text, encoding="utf-8")
    return file


def test_a_box_of_ten_decades_is_not_judged_from_its_middle(project: Path, studies: Run) -> None:
    make_wide_case(project, "1e-6", "1e4")
    answer = studies("check", "bad", "--profile", "smoke", "--json")
    assert answer.code == 0, answer.out
    assert set(levels(answer).values()) == {"ok"}
    assert any(
        one["found"].startswith("none for some parameters; at the best of 9 points: MSE ")
        for one in answer.document["findings"]
    )


def test_a_middle_that_fails_is_no_verdict_about_the_box(project: Path, studies: Run) -> None:
    file = make_bad_case(project, "NANS")
    text = re.sub(r"^estimate = .*\n", "", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    head, trouble = text.split('name = "trouble"')
    file.write_text(f'{head}name = "trouble"' + trouble.replace("upper = 1", "upper = 2.2", 1), "utf-8")
    answer = studies("check", "bad", "--profile", "smoke", "--json")
    found = {one["what"]: one for one in answer.document["findings"]}
    assert found["middle of the box"]["level"] == "warn"
    # The rest of the box is examined.
    assert "corners of the box" in found


def answered(case: Case, shifts: FloatArray, n: int = N_COVERAGE) -> Asked:
    """Return answers to the first points of the box: what was measured, shifted."""
    y = case.measurement.y[None] + shifts[:, None, None]
    names = case.parameter_space.names, case.measurement.output_names
    theta = coverage_points(case)[: len(shifts)]
    rows = Trajectories(theta, y, case.measurement.time, *names, ("",) * len(shifts))
    return Asked(np.arange(len(shifts)), rows, n)


@pytest.mark.parametrize(
    ("n", "sides", "level"),
    [(9, (1.0, 2.0), None), (64, (1.0, 2.0), "warn"), (9, (-1.0, 1.0), "ok"), (64, (-1.0, 1.0), "ok")],
)
def test_few_simulations_show_that_a_measurement_is_covered_and_never_that_it_is_not(
    n: int, sides: tuple[float, float], level: str | None
) -> None:
    case = load_case(TWO_ROOMS).experiments[0]
    found = answered(case, np.linspace(*sides, n))
    assert [one.level for one in look_at_coverage(case, found, found.answer)] == [level] * (level is not None)


@pytest.mark.parametrize(("n", "level"), [(9, None), (64, "fail")])
def test_few_failures_do_not_condemn_a_box(n: int, level: str | None) -> None:
    case = load_case(TWO_ROOMS).experiments[0]
    asked = answered(case, np.linspace(1.0, 2.0, n))
    y = np.full_like(asked.answer.y, np.nan)
    failed = replace(asked, answer=replace(asked.answer, y=y, failures=("SIGSEGV",) * n))
    found = look_at_coverage(case, failed, failed.answer.take([]))
    assert [one.level for one in found if one.level == "fail"] == [level] * (level is not None)


# Time


def test_a_check_without_a_time_out_ends_by_a_limit_of_its_own_and_names_it(project: Path) -> None:
    file = make_bad_case(project, "HANG")
    edit(file, ("timeout_s = 1", "# timeout_s = 1"))
    # Where `trouble` is at its upper bound, a simulation never ends. The first one may start the processes.
    found = examined(project, file, limit_s=5.0)
    by_name = {one.what: one for one in found.findings}
    assert found.is_sound, by_name
    assert "the check's own limit of 5.0 s" in by_name["left out"].found
    assert "influence of the parameters (" in by_name["left out"].found


def test_a_healthy_model_whose_simulation_takes_longer_than_the_check_is_sound(project: Path) -> None:
    file = make_bad_case(project, "GOOD")
    edit(file, ("timeout_s = 1", "# timeout_s = 1"))
    found = examined(project, file, limit_s=0.0)
    by_name = {one.what: one for one in found.findings}
    assert found.is_sound
    assert by_name["estimates"].level == "ok"
    assert "corners of the box" in by_name["left out"].found


def test_the_first_simulation_has_the_time_that_the_case_gives_it() -> None:
    policy = TimeBudget(1, False, None).first_policy(ExecutionPolicy())
    assert policy.limit_s(None) == FIRST_LIMIT_S == 86_400.0
    assert policy.limit_in_words(None) == (
        "it is stopped after 86400 s; [simulation] timeout_s sets another limit"
    )
    given = TimeBudget(1, False, 7.0).first_policy(ExecutionPolicy(timeout_s=7.0))
    assert given.limit_in_words(None) == "[simulation] timeout_s stops it after 7 s"


def test_a_limit_of_the_check_is_not_said_to_be_the_case_s() -> None:
    later = TimeBudget(1, False, None, simulation_s=0.5).policy(ExecutionPolicy())
    assert later.limit_in_words(0.5) == "the limit of this check stops it after 15 s"
    assert later.why_stopped(0.5) == "did not answer within 15 s and was stopped (the limit of this check)"
    assert TimeBudget(1, True, None, simulation_s=0.5).policy(ExecutionPolicy()).timeout_s is None


def test_the_time_counts_from_the_end_of_the_first_simulation() -> None:
    budget = TimeBudget(1, False, None, limit_s=50.0)
    budget.begin()
    assert 0.0 < budget.until - monotonic() <= 50.0


# Reasons


def test_units_come_first_where_the_estimates_fail_and_some_are_undeclared(
    project: Path, studies: Run
) -> None:
    file = make_bad_case(project, "NANS")
    edit(file, ("estimate = 0.1", "estimate = 1.0"))
    answer = studies("check", "bad", "--profile", "smoke", "--json")
    assert answer.code == 1
    (line,) = [one for one in answer.document["findings"] if one["level"] == "fail"]
    assert "nan" in line["found"]
    remedy = line["remedy"]
    assert remedy.startswith(
        "first check values and units of inputs, parameters and [fixed] (the FMU declares"
    )
    assert "no unit of trouble)" in remedy
    assert remedy.index("units") < remedy.index("another tool")


@pytest.mark.parametrize(
    ("tool", "level", "said"),
    [
        ("PythonFMU 0.6.9", "ok", "runs in Python"),
        ("PythonFMU3 0.3.1", "ok", "runs in Python"),
        ("Dymola 2026x", "warn", "calls another program"),
    ],
)
def test_a_python_script_needs_no_tool(tool: str, level: str, said: str) -> None:
    case = load_case(TWO_ROOMS).experiments[0]
    name: Interface = "co-simulation"
    interface = replace(case.fmu.interfaces[name], needs_execution_tool=True)
    fmu = replace(case.fmu, generation_tool=tool, interfaces={name: interface})
    (found,) = [one for one in look_at_declaration(replace(case, fmu=fmu)) if one.what == "FMU"]
    assert found.level == level
    assert said in found.found


# Columns and signs


def test_swapped_columns_of_inputs_are_named(project: Path, studies: Run) -> None:
    file = add_case(project)
    room, outdoor = 'column = "TRoom_degC"', 'column = "TOutdoor_degC"'
    edit(file, (room, "column = 1"), (outdoor, room), ("column = 1", outdoor))
    answer = studies("check", "wall", "--profile", "smoke", "--json")
    (line,) = [one for one in answer.document["findings"] if one["what"] == "columns and signs"]
    assert line["level"] == "warn"
    assert line["found"].startswith("the columns of TIn and TOut swapped: ")


def simulated(case: Case, settings: Any = None, n: int = 40) -> Trajectories:
    """Simulate the estimates and points all over the box, as the check does."""
    with (settings or case.settings).open() as model:
        return model.simulate(np.vstack([case.parameter_space.expected, coverage_points(case)[:n]]))


def test_other_orders_and_signs_are_named_where_they_are_right_and_nowhere_else() -> None:
    whole = load_case(TWO_ROOMS)
    (case,) = [one for one in whole.experiments if one.experiment == "in-turn"]
    known, others = simulated(case), input_mixups(case)
    assert {one.said for one in others} == {
        *(f"the sign of {name} changed" for name in ("sun", "q1", "q2")),
        "the columns of q1 and q2 swapped",
    }
    tried = [(one, simulated(case, one.settings)) for one in others]
    assert better_inputs(case, known, tried) == []
    assert better_outputs(case, known) == []
    # The model as if the case had it the wrong way: the right one is then the other way round.
    for one in others[1:]:
        wrong = replace(case, settings=one.settings, scenario=one.settings.scenario)
        back = next(other for other in input_mixups(wrong) if other.said == one.said)
        found = better_inputs(wrong, simulated(wrong), [(back, simulated(wrong, back.settings))])
        assert [said for _, said in found] == [one.said]
    first, second = case.measurement.outputs
    pair = (replace(first, samples=second.samples), replace(second, samples=first.samples))
    swapped = replace(case, measurement=replace(case.measurement, outputs=pair))
    assert [said for _, said in better_outputs(swapped, known)] == [
        "the columns of TRoom1 and TRoom2 swapped"
    ]


def test_the_sign_of_a_measured_column_is_named() -> None:
    case = load_case(TWO_ROOMS.parent / "thermostat")
    known = simulated(case, n=16)
    assert better_outputs(case, known) == []
    air, energy = case.measurement.outputs
    turned = Samples(energy.samples.time, -energy.samples.values)
    outputs = (air, replace(energy, samples=turned))
    wrong = replace(case, measurement=replace(case.measurement, outputs=outputs))
    assert [said for _, said in better_outputs(wrong, known)] == ["the sign of energy changed"]


def test_a_simulation_that_diverges_is_no_good_estimate() -> None:
    """An explicit solver inside an FMU of a mass and a spring ended at 1e13 mm, and that was called ok."""
    case = load_case(Path(__file__).parents[2] / "fmus" / "wall")
    names, time, outputs = case.parameter_space.names, case.measurement.time, case.measurement.output_names
    near = np.tile([one.samples.values.mean() for one in case.outputs], (1, len(time), 1))
    for y, level in ((near, "ok"), (near + 1e200, "warn")):
        answer = Trajectories(np.ones((1, len(names))), y, time, names, outputs, ("",))
        first = next(iter(look_at_estimates(case, answer)))
        assert first.level == level
    assert "diverges" in first.found
    assert "lower communication_step_s" in first.remedy
