"""The keys of a case file beyond the plain case: units, bands, patience, warm-up, validation, other kinds."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from case_for_tests import edit

from simulation import InputError, load_case
from simulation.case_parts import with_units
from simulation.pool.execution import ExecutionPolicy
from simulation.robust_loss import RobustLoss

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
    with pytest.raises(InputError, match=r"inputs\[u\] is also in \[\[parameters\]\]; keep"):
        load_case(decay_case)


def test_a_row_outside_the_accepted_band_has_failed(decay_case: Path):
    edit(decay_case, ("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [0.0, 200.0]"))
    with load_case(decay_case).open_model() as model:
        answer = model.simulate(np.array([[1e-9, 0.0], [1e-4, 0.0]]))
    assert answer.failures == (
        "",
        "output y is -26.8883 at 23400 s, outside the accepted 0 to 200",
    )
    assert np.isnan(answer.y[1]).all()


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
    assert validation.measurement.outputs[0].samples.time.tolist() == [70200 + 1800 * i for i in range(10)]
    assert validation.fixed == case.fixed
    with case.open_model() as model, validation.open_model() as longer:
        np.testing.assert_array_equal(longer.simulate(ROWS).y[:, :n], model.simulate(ROWS).y)
    assert case.model_digest != validation.model_digest


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
    ("keys", "loss"),
    [
        ("", None),
        ('loss = "squares"', None),
        ('loss = "huber"', RobustLoss("huber", 1.0)),
        ('loss = "soft-l1"\nloss_scale = 0.3', RobustLoss("soft-l1", 0.3)),
    ],
)
def test_a_loss_is_of_its_output_and_changes_the_measurement_alone(
    decay_case: Path, keys: str, loss: RobustLoss | None
):
    plain = load_case(decay_case)
    edit(decay_case, ("uncertainty = 0.5", f"uncertainty = 0.5\n{keys}"))
    case = load_case(decay_case)
    assert case.outputs[0].loss == loss
    assert (case.measurement.digest == plain.measurement.digest) == (loss is None)
    # Surrogates and stored simulations know these digests.
    assert (case.digest, case.model_digest) == (plain.digest, plain.model_digest)


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


def test_patience_is_declared_and_changes_no_digest(decay_case: Path):
    before = load_case(decay_case)
    assert before.policy == ExecutionPolicy()
    edit(decay_case, ("[fixed]", "[simulation]\ntimeout_s = inf\nretries = 2\nmax_workers = 1\n\n[fixed]"))
    after = load_case(decay_case)
    assert after.policy == ExecutionPolicy(timeout_s=math.inf, retries=2, max_workers=1)
    assert after.policy.finite_timeout_s is None
    assert (after.digest, after.model_digest) == (before.digest, before.model_digest)
