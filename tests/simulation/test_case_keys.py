"""The keys of a case file beyond the plain case: units, bands, patience, warm-up, validation, other kinds."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulation import InputError, load_case
from simulation.case_parts import with_units
from simulation.pool.execution import ExecutionPolicy

DAY = 86400


def edit(folder: Path, *pairs: tuple[str, str]) -> None:
    """Replace text in the case file."""
    text = (folder / "case.toml").read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    (folder / "case.toml").write_text(text)


ROWS = np.array([[1e-4, 0.0], [3e-5, 0.0]])


def answers(folder: Path, rows: np.ndarray = ROWS) -> np.ndarray:
    with load_case(folder).open_model() as model:
        answer = model.simulate(rows)
    assert not answer.failed.any(), answer.failures
    return answer.y


def test_the_same_case_in_other_units_answers_the_same(decay_case: Path):
    before, plain = answers(decay_case), load_case(decay_case)
    text = (decay_case / "data" / "recording.csv").read_text().splitlines()
    rows = []
    for line in text[1:]:
        time, celsius, heating = (float(cell) for cell in line.split(","))
        rows.append(f"{time:g},{celsius * 1.8 + 32:.9f},{heating * 3600:.9f}")
    (decay_case / "data" / "recording.csv").write_text("\n".join([text[0], *rows]) + "\n")
    edit(
        decay_case,
        ('unit = "degC"', 'unit = "degF"'),
        ("uncertainty = 0.5", "uncertainty = 0.9"),
        ('unit = "K/s"', 'unit = "K/h"'),
        (
            'estimate = 1e-4\nlower = 2e-5\nupper = 5e-4\nunit = "1/s"',
            'lower = 0.072\nupper = 1.8\nunit = "1/h"',
        ),
    )
    case = load_case(decay_case)
    np.testing.assert_allclose(case.scenario.inputs, plain.scenario.inputs, rtol=1e-5)
    np.testing.assert_allclose(case.fixed["x0"], plain.fixed["x0"], rtol=1e-9)
    np.testing.assert_allclose(answers(decay_case, ROWS * [3600, 1]), before * 1.8 + 32, rtol=1e-6)
    assert case.model_digest != plain.model_digest
    # In other words, the errors are the same too: 1.8^2 times.
    mse = case.measurement.mse(before * 1.8 + 32)
    np.testing.assert_allclose(mse, 1.8**2 * plain.measurement.mse(before), rtol=1e-6)


def test_an_initial_temperature_is_calibrated_in_degrees_celsius(decay_case: Path):
    edit(
        decay_case,
        ('name = "mode"\nlower = 0\nupper = 6', 'name = "x0"\nlower = 10\nupper = 30\nunit = "degC"'),
    )
    edit(decay_case, ('x0 = { first_measured = "y" }', "mode = 0"))
    y = answers(decay_case, np.array([[1e-4, 20.0], [1e-4, 25.0]]))
    np.testing.assert_allclose(y[:, 0, 0], [20.0, 25.0], atol=1e-9)


@pytest.mark.parametrize(
    ("value", "kelvin"),
    [('{ value = 7.0, unit = "degC" }', 280.15), ("280.15", 280.15), ("280", 280.0), ("1" + 30 * "0", 1e30)],
)
def test_a_fixed_value_may_have_a_unit(decay_case: Path, value: str, kelvin: float):
    edit(decay_case, ('{ first_measured = "y" }', value))
    assert load_case(decay_case).fixed == {"x0": pytest.approx(kelvin)}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ('{ value = 7.0, unit = "W" }', r'fixed\.x0: unit = "W" contradicts the FMU\'s "K"'),
        ("true", r"fixed\.x0 = true: x0 is of type Real; give a number"),
        ('"warm"', r"fixed\.x0 = 'warm': x0 is of type Real; give a number"),
        ("[1.0]", r"fixed\.x0 = \[1\.0\]: give a number, true or false, a text, \{ value = 20\.0"),
        ("{ value = 7.0 }", r"toml: fixed\.x0 = \{'value': 7\.0\}: give a number, .*, \{ value = 20\.0"),
        ('{ value = 7.0, unti = "K" }', r"toml: fixed\.x0 = \{'value': 7\.0, 'unti': 'K'\}: give a number"),
        ("1" + 400 * "0", r"toml: fixed\.x0 = 10{196}\.\.\.: give a number"),
        ("1" + 5000 * "0", r"toml: a number has thousands of digits; correct it"),
        ("nan", r"toml: fixed\.x0 = nan: give a number"),
        (
            "1.0\ntank.h.start = 2.0",
            r"toml: fixed\.tank = .*: a name with dots .*; write \"tank\.h\.start\" =",
        ),
        ('1.0\ntank.h = { value = 2.0, unit = "m" }', r"a name with dots .*; write \"tank\.h\" ="),
    ],
)
def test_a_wrong_fixed_value_is_one_line(decay_case: Path, value: str, message: str):
    edit(decay_case, ('{ first_measured = "y" }', value))
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)


def test_fixed_that_is_no_table_is_one_line(decay_case: Path):
    edit(
        decay_case,
        ("[fixed]\n", ""),
        ('x0 = { first_measured = "y" }', ""),
        ('name = "decay"', 'name = "decay"\nfixed = 3'),
    )
    with pytest.raises(InputError, match=r"toml: fixed = 3: is no table; write its keys as a table"):
        load_case(decay_case)


def test_an_input_is_calibrated_as_a_constant(decay_case: Path):
    text = (decay_case / "case.toml").read_text()
    begin, end = text.index("[[inputs]]"), text.index("[[outputs]]")
    inputs = text[begin:end]
    constant = '[[parameters]]\nname = "u"\nlower = 0.0\nupper = 3.6\nunit = "K/h"\n\n'
    (decay_case / "case.toml").write_text(text.replace(inputs, "").replace("[fixed]", constant + "[fixed]"))
    case = load_case(decay_case)
    assert case.parameter_space.names == ("k", "mode", "u")
    assert case.scenario.input_names == ()
    k, heating = 1e-4, 1.8
    with case.open_model() as model:
        answer = model.simulate(np.array([[k, 0.0, 0.0], [k, 0.0, heating], [k, 0.0, 0.0]]))
    assert answer.failures == ("", "", "")
    cold, warm, again = answer.y[:, :, 0]
    np.testing.assert_array_equal(again, cold)
    # x' = -k x + u: a constant input adds u / k (1 - exp(-k t)).
    since_start = case.scenario.time - case.scenario.time[0]
    expected = heating / 3600.0 / k * -np.expm1(-k * since_start)
    np.testing.assert_allclose(warm - cold, expected, atol=1e-9)
    both = text.replace("[fixed]", constant + "[fixed]")
    (decay_case / "case.toml").write_text(both)
    with pytest.raises(InputError, match=r"inputs\[u\] is also under \[\[parameters\]\]; drop one"):
        load_case(decay_case)


def test_patience_is_declared_and_changes_no_digest(decay_case: Path):
    before = load_case(decay_case)
    assert before.policy == ExecutionPolicy()
    edit(
        decay_case,
        (
            "[fixed]",
            "[simulation]\ntimeout_s = 30\nretries = 2\nmax_failed_share = 0.9\nmax_workers = 1\n\n[fixed]",
        ),
    )
    after = load_case(decay_case)
    assert after.policy == ExecutionPolicy(timeout_s=30, retries=2, max_failed_share=0.9, max_workers=1)
    assert (after.digest, after.model_digest) == (before.digest, before.model_digest)
    edit(decay_case, ("timeout_s = 30", "timeout_s = inf"))
    never = load_case(decay_case).policy
    assert (never.timeout_s, never.finite_timeout_s) == (math.inf, None)


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("lower = 2e-5", "lower = 3e-5", True),
        ("estimate = 1e-4", "estimate = 2e-4", True),
        ("uncertainty = 0.5", "uncertainty = 0.7\nweight = 2", True),
        ("output_step_s = 1800", "output_step_s = 1200", False),
        ("schema = 1", "schema = 1\nrelative_tolerance = 1e-8", False),
        ("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [-50, 90]", False),
        ("[time]\n", "[time]\nstart_d = 0\n", False),
        ("[time]\n", "[time]\nvalidation_d = [0.75, 1.0]\n", True),
        ('unit = "degC"', 'unit = "K"', False),
    ],
)
def test_simulations_are_the_same_where_the_model_digest_is(decay_case: Path, old: str, new: str, same: bool):
    before = load_case(decay_case)
    edit(decay_case, (old, new))
    assert (load_case(decay_case).model_digest == before.model_digest) is same


def test_a_row_outside_the_accepted_band_has_failed(decay_case: Path):
    edit(decay_case, ("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [0.0, 200.0]"))
    with load_case(decay_case).open_model() as model:
        answer = model.simulate(np.array([[1e-9, 0.0], [1e-4, 0.0]]))
    assert answer.failures == (
        "",
        "output y is -26.8883 at 23400 s, outside the accepted 0 to 200",
    )
    assert np.isnan(answer.y[1]).all()


@pytest.mark.parametrize(
    ("band", "message"),
    [
        ("[21.0, 19.0]", r"outputs\[y\]: accepted = \[21, 19\] holds nothing; give the lower value first"),
        (
            "[20.0, 20.5]",
            r"outputs\[y\]: accepted = \[20, 20\.5\] leaves out the measured 20\.\d+ at \d+ s; widen",
        ),
        ("[20.0]", r"outputs\[y\]\.accepted"),
    ],
)
def test_a_wrong_band_is_one_line(decay_case: Path, band: str, message: str):
    edit(decay_case, ("uncertainty = 0.5", f"uncertainty = 0.5\naccepted = {band}"))
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)


def test_a_shared_warm_up_starts_from_the_expected_parameters(decay_case: Path):
    edit(decay_case, ("[time]\n", "[time]\nshared_warmup = true\n"))
    with pytest.raises(InputError, match=r"shared_warmup = true, but the simulation starts with the window"):
        load_case(decay_case)
    edit(decay_case, ("[time]\n", "[time]\nstart_d = 0\n"))
    settings = load_case(decay_case).settings
    # The estimate of k, the middle of mode's bounds.
    assert settings.warmup_theta is not None
    assert settings.warmup_theta.tolist() == [1e-4, 3.0]


def test_validation_goes_on_where_the_window_ends(decay_case: Path):
    edit(decay_case, ("[time]\n", "[time]\nstart_d = 0\nvalidation_d = [0.8125, 1.0]\n"))
    case = load_case(decay_case)
    validation = case.validation
    assert validation is not None
    assert validation.window_d == (0.8125, 1.0)
    assert validation.validation is None
    # Days 0.25 to 1 are reported, days 0.8125 to 1 compared; both start on day 0 with the same state.
    assert validation.scenario.n_warmup == case.scenario.n_warmup == 12
    n = len(case.measurement.time)
    np.testing.assert_array_equal(validation.scenario.time[:n], case.scenario.time)
    assert validation.measurement.samples[0].time.tolist() == [70200 + 1800 * i for i in range(10)]
    assert validation.fixed == case.fixed
    with case.open_model() as model, validation.open_model() as longer:
        np.testing.assert_array_equal(longer.simulate(ROWS).y[:, :n], model.simulate(ROWS).y)
    assert case.model_digest != validation.model_digest


def test_validation_before_the_window_is_possible_where_the_simulation_starts_earlier(decay_case: Path):
    edit(
        decay_case,
        ("[0.25, 0.75]", "[0.5, 1.0]"),
        ("[time]\n", "[time]\nstart_d = 0\nvalidation_d = [0.25, 0.5]\n"),
    )
    validation = load_case(decay_case).validation
    assert validation is not None
    assert validation.scenario.time[[0, -1]].tolist() == [21600, 43200]
    assert validation.scenario.n_warmup == 12


def test_a_window_of_the_caller_may_leave_no_validation(decay_case: Path):
    edit(decay_case, ("[time]\n", "[time]\nvalidation_d = [0.75, 1.0]\n"))
    assert load_case(decay_case).validation is not None
    assert load_case(decay_case, window_d=(0.5, 0.75)).validation is not None
    assert load_case(decay_case, window_d=(0.5, 1.0)).validation is None


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            "validation_d = [0.5, 1.0]",
            r"validation_d = \[0\.5, 1\] overlaps with window_d = \[0\.25, 0\.75\]",
        ),
        (
            "validation_d = [0.0, 0.25]",
            r"validation_d = \[0, 0\.25\] begins before the simulation, day 0\.25",
        ),
        (
            "validation_d = [1.0, 0.75]",
            r"time\.validation_d = \[1, 0\.75\]: the end must lie after the start",
        ),
        ("validation_d = [0.75, 2.0]", r"validation_d = \[0\.75, 2\]: the recording .* ends at day 1;"),
        (
            "validation_d = [0.75, 0.76]",
            r"validation_d = \[0\.75, 0\.76\]: not a whole number of output steps",
        ),
        (
            "start_d = 0\nshared_warmup = true\nvalidation_d = [0.0, 0.25]",
            r"validation_d = \[0, 0\.25\] lies in the warm-up, which is shared",
        ),
    ],
)
def test_a_wrong_validation_period_is_one_line(decay_case: Path, keys: str, message: str):
    edit(decay_case, ("[time]\n", f"[time]\n{keys}\n"))
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[fixed]",
            "[simulation]\ntimeout_s = 0\n[fixed]",
            r"simulation\.timeout_s = 0: .*greater than 0; correct it",
        ),
        (
            "[fixed]",
            "[simulation]\nretry = 1\n[fixed]",
            r"unknown key simulation\.retry \(did you mean retries\?\)",
        ),
        (
            "[fixed]",
            "[simulation]\nmax_failed_share = 2\n[fixed]",
            r"simulation\.max_failed_share = 2: .*correct it",
        ),
        ("schema = 1", "schema = 1\nrelative_tolerance = 0.0", r"relative_tolerance = 0\.0: .*correct it"),
        (
            "co-simulation",
            "cosimulation",
            r"interface = 'cosimulation': .*'co-simulation' or 'model-exchange'",
        ),
        (
            "co-simulation",
            "model-exchange",
            r"decay\.fmu has no model-exchange interface; write interface = \"co-s",
        ),
        ("uncertainty = 0.5", "uncertainty = 0.5\nweight = 0", r"outputs\[y\]\.weight = 0: .*correct it"),
        ('"linear"', '"linear"\nmax_gap_s = -1', r"inputs\[u\]\.max_gap_s = -1: .*correct it"),
    ],
)
def test_a_wrong_key_is_one_line(decay_case: Path, old: str, new: str, message: str):
    edit(decay_case, (old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)


def in_seconds(folder: Path) -> None:
    edit(
        folder,
        ("window_d = [0.25, 0.75]\ncomm", "window_s = [21600, 64800]\ncomm"),
        ("[time]\n", "[time]\nstart_s = 0\nvalidation_s = [70200, 86400]\n"),
    )


def test_seconds_mean_the_same_as_days(decay_case: Path):
    text = (decay_case / "case.toml").read_text()
    edit(decay_case, ("[time]\n", "[time]\nstart_d = 0\nvalidation_d = [0.8125, 1.0]\n"))
    days = load_case(decay_case)
    (decay_case / "case.toml").write_text(text)
    in_seconds(decay_case)
    seconds = load_case(decay_case)
    assert (seconds.digest, seconds.model_digest) == (days.digest, days.model_digest)
    assert seconds.measurement.digest == days.measurement.digest
    assert seconds.references == days.references
    assert seconds.validation is not None
    assert days.validation is not None
    assert seconds.validation.measurement.digest == days.validation.measurement.digest


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([("start_s = 0", "start_d = 0")], r"time: start_d beside window_s; write start_s"),
        (
            [("validation_s = [7", "validation_d = [7")],
            r"time: validation_d beside window_s; write validation_s",
        ),
        ([("start_s = 0", "window_d = [0, 1]")], r"time: both window_d and window_s are given; give one"),
        ([("window_s = [21600, 64800]\ncomm", "comm")], r"time: key window_d is missing; give one.* seconds"),
        ([("start_s = 0", "start_s = 30000")], r"start_s = 30000 does not lie between 0 s and .* 21600;"),
        (
            [("window_s = [21600, 64800]", "window_s = [21600, 90000]")],
            r"window_s = .* ends at 86400 s; sh",
        ),
        (
            [("window_s = [21600, 64800]", "window_s = [21600, 64801]")],
            r"window_s = .* choose times that fit",
        ),
        (
            [("[70200, 86400]", "[60000, 86400]")],
            r"validation_s = .* overlaps with window_s = \[21600, 64800\]",
        ),
        ([("[70200, 86400]", "[86400, 70200]")], r"validation_s = .* neither before 0 s"),
    ],
)
def test_what_is_wrong_with_seconds_is_told_in_seconds(
    decay_case: Path, pairs: list[tuple[str, str]], message: str
):
    in_seconds(decay_case)
    load_case(decay_case)
    edit(decay_case, *pairs)
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)


def test_the_case_says_the_unit_that_the_fmu_does_not(decay_case: Path):
    plain = load_case(decay_case)
    assert plain.fmu.variables["y"].unit == "K"
    edit(decay_case, ('unit = "degC"', 'unit = "degC"\nfmu_unit = "degC"'))
    with pytest.raises(InputError, match=r'y: fmu_unit = "degC" contradicts the FMU\'s "K"; drop it'):
        load_case(decay_case)
    edit(decay_case, ('fmu_unit = "degC"', 'fmu_unit = "K"'))
    said = load_case(decay_case)
    assert said.settings.output_offsets.tolist() == plain.settings.output_offsets.tolist() == [-273.15]
    assert said.model_digest != plain.model_digest
    silent = replace(plain.fmu.variables["y"], unit="")
    bare = replace(plain.fmu, variables={**plain.fmu.variables, "y": silent})
    assert with_units(bare, {"y": "K"}).variables["y"].unit == "K"
    assert with_units(bare, {"z": "K"}) is bare
