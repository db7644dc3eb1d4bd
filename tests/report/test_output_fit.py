"""CV(RMSE) and NMBE of an output, and where they say nothing."""

import numpy as np
import pytest

from simulation.measurement import Measurement
from studies.results.stage_results import OutputFit
from studies.stages.calibrated_point import output_fit


def fit(unit: str, off: list[float], values: list[float] | None = None) -> OutputFit:
    measured = np.array(values or [80.0, 120.0, 100.0, 100.0])[:, None]
    time = 3600.0 * np.arange(len(measured))
    measurement = Measurement.on_grid(time, measured, ("QRoom",), np.array([2.0]))
    return output_fit(measurement, 0, unit, measured + np.array(off)[:, None])


def test_the_measures_are_shares_of_the_mean() -> None:
    found = fit("W", [30.0, -10.0, 10.0, 10.0])
    assert found.cv_rmse == pytest.approx(np.sqrt(1200.0 / 3.0) / 100.0)
    assert found.nmbe == pytest.approx(40.0 / 3.0 / 100.0)


def test_of_negative_values_too_high_is_positive_as_well() -> None:
    found = fit("W", [6.0] * 4, [-80.0, -120.0, -100.0, -100.0])
    assert (found.cv_rmse, found.nmbe) == (pytest.approx(0.12 / np.sqrt(3.0)), pytest.approx(0.08))


@pytest.mark.parametrize(
    ("unit", "values"),
    [
        ("degC", None),  # the zero of a temperature is a convention
        ("K", None),
        ("W", [1.0, -1.0, 1.0, -1.0]),  # nothing is a share of a mean of zero
        ("W", [100.0]),  # one value has no spread
    ],
)
def test_no_share_of_a_mean_that_says_nothing(unit: str, values: list[float] | None) -> None:
    found = fit(unit, [1.0] * len(values or [0.0] * 4), values)
    assert (found.rmse, found.bias) == (pytest.approx(1.0), pytest.approx(1.0))
    assert (found.cv_rmse, found.nmbe) == (None, None)
