"""ASHRAE guideline 14: its measures and limits, and where they say nothing."""

import numpy as np
import pytest

from simulation.measurement import Measurement
from studies.report.guideline14 import HOURLY, MONTHLY, guideline_sentence, judge

HOUR_S = 3600.0


def series(step_s: float, values: list[float]) -> Measurement:
    time = step_s * np.arange(len(values))
    return Measurement.on_grid(time, np.array(values)[:, None], ("QRoom",), np.array([2.0]))


def judged(step_s: float, unit: str, off: list[float], values: list[float] | None = None):  # type: ignore[no-untyped-def]
    measurement = series(step_s, values or [80.0, 120.0, 100.0, 100.0])
    return judge(measurement, [unit], measurement.y + np.array(off)[:, None])[0]


def test_the_measures_are_shares_of_the_mean() -> None:
    found = judged(HOUR_S, "W", [30.0, -10.0, 10.0, 10.0])
    assert found.cv_rmse == pytest.approx(np.sqrt(300.0) / 100.0)
    assert found.nmbe == pytest.approx(0.10)
    assert found.limits is HOURLY
    assert found.is_met


def test_of_negative_values_too_high_is_positive_as_well() -> None:
    found = judged(HOUR_S, "W", [5.0] * 4, [-80.0, -120.0, -100.0, -100.0])
    assert (found.cv_rmse, found.nmbe) == (pytest.approx(0.05), pytest.approx(0.05))


@pytest.mark.parametrize(
    ("step_s", "off", "limits", "is_met"),
    [
        (HOUR_S, [29.0, -29.0, 29.0, -29.0], HOURLY, True),
        (HOUR_S, [31.0, -31.0, 31.0, -31.0], HOURLY, False),
        (HOUR_S, [-11.0] * 4, HOURLY, False),
        (600.0, [29.0, -29.0, 29.0, -29.0], HOURLY, True),
        (30.4 * 24 * HOUR_S, [14.0, -14.0, 14.0, -14.0], MONTHLY, True),
        (30.4 * 24 * HOUR_S, [16.0, -16.0, 16.0, -16.0], MONTHLY, False),
        (28 * 24 * HOUR_S, [6.0] * 4, MONTHLY, False),
    ],
)
def test_limits_follow_the_interval(step_s: float, off: list[float], limits: object, is_met: bool) -> None:
    found = judged(step_s, "kW", off)
    assert found.limits is limits
    assert found.is_met is is_met
    assert ("not met" in found.sentence) is not is_met


@pytest.mark.parametrize(
    ("unit", "step_s", "values", "reason"),
    [
        ("degC", HOUR_S, None, "the zero of a temperature is a convention"),
        ("K", HOUR_S, None, "the zero of a temperature is a convention"),
        ("W", HOUR_S, [1.0, -1.0, 1.0, -1.0], "the mean measured value is zero"),
        ("kg/s", HOUR_S, None, "they are for energy and power, and its unit is kg/s"),
        ("W", 24 * HOUR_S, None, "a value is measured every 24 h"),
    ],
)
def test_where_there_is_no_limit_the_reason_is_told(
    unit: str, step_s: float, values: list[float] | None, reason: str
) -> None:
    found = judged(step_s, unit, [1.0] * 4, values)
    assert found.is_met is None
    assert reason in guideline_sentence([found])
    assert found.to_dict()["is_met"] is None


@pytest.mark.parametrize("unit", ["J", "kWh", "W/m2", "kWh/m2", "GJ"])
def test_energy_and_power_also_per_area_are_limited(unit: str) -> None:
    assert judged(HOUR_S, unit, [1.0] * 4).limits is HOURLY
