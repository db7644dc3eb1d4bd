"""Samples that are means over an interval: what they are compared with, which of them belong to a window."""

from pathlib import Path

import numpy as np
import pytest
from case_for_tests import edit

from simulation import InputError, Measurement, load_case
from simulation.measurement import MeasuredOutput
from simulation.samples import Samples

GRID = np.arange(0.0, 7201.0, 600.0)
INTERVALS = {"end": (-3600.0, 0.0), "begin": (0.0, 3600.0), "centre": (-1800.0, 1800.0)}


def means(series: np.ndarray, times: np.ndarray, interval: tuple[float, float]) -> np.ndarray:
    """Return the means of straight lines between output times, by brute force."""
    fine = np.linspace(0.0, 1.0, 36_001)
    ends = [(time + interval[0], time + interval[1]) for time in times]
    return np.array([np.trapezoid(np.interp(a + (b - a) * fine, GRID, series), fine) for a, b in ends])


@pytest.mark.parametrize("stamp", INTERVALS)
@pytest.mark.parametrize("times", [[3600.0], [3600.0, 3700.0, 4321.0], [1801.0, 3599.0, 3601.0]])
def test_a_mean_is_compared_with_the_mean(stamp: str, times: list[float]):
    low, high = INTERVALS[stamp]
    at = np.array([one for one in times if one + low >= 0.0 and one + high <= GRID[-1]])
    y = 300.0 + np.random.default_rng(0).normal(size=(5, len(GRID), 1))
    samples = Samples(at, np.full(len(at), 299.0), (low, high))
    measurement = Measurement(GRID, (MeasuredOutput("T", "K", samples, 0.5),))
    expected = [means(row[:, 0], at, (low, high)) - 299.0 for row in y]
    np.testing.assert_allclose(measurement.compared(y), expected, atol=1e-7)
    # No row depends on the others, not in its last digit.
    np.testing.assert_array_equal(measurement.compared(y[2:3])[0], measurement.compared(y)[2])


def test_intervals_shorter_than_an_output_step_lie_on_the_lines():
    samples = Samples(np.array([700.0, 1150.0, 1250.0]), np.zeros(3), (-100.0, 0.0))
    y = (GRID**2 / 1e4)[None, :, None]
    found = Measurement(GRID, (MeasuredOutput("T", "K", samples, 1.0),)).compared(y)
    np.testing.assert_allclose(found[0], means(y[0, :, 0], samples.time, (-100.0, 0.0)), atol=1e-6)


def test_moments_and_means_differ_in_the_digest():
    def digest(interval: tuple[float, float]) -> str:
        samples = Samples(GRID[6:], np.ones(7), interval)
        return Measurement(GRID, (MeasuredOutput("T", "K", samples, 1.0),)).digest

    assert len({digest((0.0, 0.0)), digest((-3600.0, 0.0)), digest((-1800.0, 0.0))}) == 3


@pytest.mark.parametrize(
    ("keys", "first", "last"),
    [
        ("", 21600, 64800),
        ("mean_over_s = 3600", 25200, 64800),
        ('mean_over_s = 3600\nmean_stamp = "end"', 25200, 64800),
        ('mean_over_s = 3600\nmean_stamp = "begin"', 21600, 61200),
        ('mean_over_s = 3600\nmean_stamp = "centre"', 23400, 63000),
    ],
)
def test_intervals_belong_to_the_window_as_a_whole(decay_case: Path, keys: str, first: int, last: int):
    edit(decay_case, ("uncertainty = 0.5", f"uncertainty = 0.5\n{keys}"))
    edit(decay_case, ("x0 = { first_measured", "# x0 = { first_measured"))
    (output,) = load_case(decay_case).outputs
    assert output.samples.time[[0, -1]].tolist() == [first, last]
    # In a window of the validation the next ones, none twice.
    edit(decay_case, ("[time]", "[time]\nvalidation_d = [0.75, 1.0]"))
    validation = load_case(decay_case).validation
    assert validation is not None
    assert validation.outputs[0].samples.time[0] == last + (3600 if keys else 1800)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('mean_stamp = "begin"', "mean_stamp is of means; add mean_over_s"),
        ("mean_over_s = 0", "greater than 0"),
        ('mean_over_s = 3600\nmean_stamp = "middle"', "mean_stamp = 'middle'"),
        (
            "mean_over_s = 3600",
            "fixed.x0: y is measured as means over 3600 s, which say nothing",
        ),
        ("mean_over_s = 86400", "has 0 values of T_degC .each a mean over 86400 s. over days 0.25 to"),
    ],
)
def test_what_cannot_be_is_refused(decay_case: Path, keys: str, said: str):
    edit(decay_case, ("uncertainty = 0.5", f"uncertainty = 0.5\n{keys}"))
    with pytest.raises(InputError, match=said):
        load_case(decay_case)


def test_experiments_have_their_means(decay_case: Path):
    edit(decay_case, ("uncertainty = 0.5", "uncertainty = 0.5\nmean_over_s = 3600"))
    edit(decay_case, ("x0 = { first_measured", "# x0 = { first_measured"))
    alone = load_case(decay_case)
    text = (decay_case / "case.toml").read_text()
    (decay_case / "case.toml").write_text(text + '[[experiments]]\nname = "a"\n[[experiments]]\nname = "b"\n')
    both = load_case(decay_case)
    row = np.random.default_rng(0).normal(20.0, 1.0, (1, 25, 1))
    found = both.measurement.differences(np.repeat(row, 2, axis=2), 1)
    np.testing.assert_allclose(found, alone.measurement.differences(row, 0), atol=1e-12)
