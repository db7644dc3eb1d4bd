"""Cases: what a good one holds, and what its digests see."""

from pathlib import Path

import numpy as np
import pytest

from simulation import InputError, load_case


def test_a_case_holds_what_its_file_says(decay_case: Path):
    case = load_case(decay_case)
    assert (case.name, case.title, case.note, case.interface) == ("decay", "One state", "", "co-simulation")
    assert case.path == decay_case / "case.toml"
    assert case.fmu.path == decay_case / "decay.fmu"
    assert case.window_d == (0.25, 0.75)
    assert (case.communication_step_s, case.output_step_s) == (600, 1800)
    assert case.parameter_space.names == ("k", "mode")
    assert case.parameter_space.is_log.tolist() == [True, False]
    assert case.scenario.input_names == ("u",)
    assert case.scenario.inputs.shape == (72, 1)
    assert case.measurement.y.shape == (25, 1)
    assert np.array_equal(case.measurement.time, case.scenario.time)
    # Measured in degC, started in K.
    assert case.fixed["x0"] == pytest.approx(case.measurement.y[0, 0] + 273.15, abs=1e-12)
    assert case.outputs[0].unit == "degC"
    assert case.measurement.uncertainty.tolist() == [0.5]


def test_a_window_of_the_caller_replaces_the_file_s(decay_case: Path):
    case = load_case(decay_case, window_d=(0, 1))
    assert case.window_d == (0.0, 1.0)
    assert len(case.measurement.time) == 49
    assert case.digest != load_case(decay_case).digest


@pytest.mark.parametrize(
    ("old", "new", "same", "same_model"),
    [
        ('title = "One state"', 'title = "Another"', True, True),
        ("estimate = 1e-4", "estimate = 2e-4", True, True),
        ("uncertainty = 0.5", "uncertainty = 0.7\nweight = 2", True, True),
        ('scale = "log"', 'scale = "log"\nprior = { within_factor = 1.5 }', True, True),
        ("[time]\n", "[time]\nvalidation_d = [0.75, 1.0]\n", True, True),
        ("lower = 2e-5", "lower = 3e-5", False, True),
        ("communication_step_s = 600", "communication_step_s = 300", False, False),
        ("[time]\n", "[time]\nstart_d = 0\n", False, False),
        ('"linear"', '"smooth"', False, False),
        ('unit = "degC"', 'unit = "K"', False, False),
        ("schema = 1", "schema = 1\nrelative_tolerance = 1e-8", False, False),
        ("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [-50, 90]", False, False),
    ],
)
def test_digests_see_what_decides_the_answers_and_nothing_else(
    decay_case: Path, old: str, new: str, same: bool, same_model: bool
):
    before = load_case(decay_case)
    text = (decay_case / "case.toml").read_text()
    assert old in text
    (decay_case / "case.toml").write_text(text.replace(old, new))
    after = load_case(decay_case)
    assert (after.digest == before.digest, after.model_digest == before.model_digest) == (same, same_model)


def test_a_communication_step_of_the_caller_replaces_the_file_s(decay_case: Path):
    case = load_case(decay_case, communication_step_s=300)
    assert case.communication_step_s == 300
    assert case.scenario.inputs.shape == (144, 1)
    with pytest.raises(InputError, match="communication_step_s = 0 is not above 0"):
        load_case(decay_case, communication_step_s=0)


def test_a_known_error_counts_for_its_window_and_not_in_the_digest(decay_case: Path):
    file, before = decay_case / "case.toml", load_case(decay_case).digest
    file.write_text(
        file.read_text()
        + '[[references]]\nlabel = "best"\nwindow_d = [0.25, 0.75]\nmse = 0.5\ntarget = true\n'
    )
    case = load_case(decay_case)
    assert [(known.label, known.mse, known.is_target) for known in case.references] == [("best", 0.5, True)]
    assert case.digest == before
    assert load_case(decay_case, window_d=(0, 0.5)).references == ()


def test_the_digest_sees_the_fmu_and_the_inputs(decay_case: Path):
    before = load_case(decay_case)
    recording = decay_case / "data" / "recording.csv"
    text = recording.read_text()
    recording.write_text(text.replace("0.001000000", "0.001000001"))
    changed_input = load_case(decay_case, window_d=(0, 0.5))
    recording.write_text(text)
    assert changed_input.digest != load_case(decay_case, window_d=(0, 0.5)).digest
    with (decay_case / "decay.fmu").open("ab") as file:
        file.write(b" ")
    assert load_case(decay_case).digest != before.digest


def test_a_sum_of_columns_is_interpolated_then_summed_then_converted(decay_case: Path):
    text = (decay_case / "case.toml").read_text()
    (decay_case / "case.toml").write_text(
        text.replace('column = "heating"', "sum = { heating = 2.0, T_degC = 0.5 }")
    )
    single = load_case(decay_case)
    (decay_case / "case.toml").write_text(text)
    heating = load_case(decay_case).scenario.inputs
    (decay_case / "case.toml").write_text(text.replace('column = "heating"', 'column = "T_degC"'))
    warmth = load_case(decay_case).scenario.inputs
    np.testing.assert_allclose(single.scenario.inputs, 2.0 * heating + 0.5 * warmth, rtol=1e-12)
