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
    assert found.cv_rmse == pytest.approx(np.sqrt(1200.0 / 3.0) / 100.0)
    assert found.nmbe == pytest.approx(40.0 / 3.0 / 100.0)
    assert found.limits is HOURLY
    assert not found.is_met


def test_of_negative_values_too_high_is_positive_as_well() -> None:
    found = judged(HOUR_S, "W", [6.0] * 4, [-80.0, -120.0, -100.0, -100.0])
    assert (found.cv_rmse, found.nmbe) == (pytest.approx(0.12 / np.sqrt(3.0)), pytest.approx(0.08))


@pytest.mark.parametrize(
    ("step_s", "off", "limits", "is_met"),
    [
        (HOUR_S, [25.0, -25.0, 25.0, -25.0], HOURLY, True),
        (HOUR_S, [27.0, -27.0, 27.0, -27.0], HOURLY, False),
        (HOUR_S, [-7.0] * 4, HOURLY, True),
        (HOUR_S, [-8.0] * 4, HOURLY, False),
        (600.0, [25.0, -25.0, 25.0, -25.0], HOURLY, True),
        (600.0, [-8.0] * 4, HOURLY, False),
        (30.4 * 24 * HOUR_S, [12.0, -12.0, 12.0, -12.0], MONTHLY, True),
        (30.4 * 24 * HOUR_S, [14.0, -14.0, 14.0, -14.0], MONTHLY, False),
        (28 * 24 * HOUR_S, [4.0] * 4, MONTHLY, False),
    ],
)
def test_limits_follow_the_interval(step_s: float, off: list[float], limits: object, is_met: bool) -> None:
    found = judged(step_s, "kW", off)
    assert found.limits is limits
    assert found.is_met is is_met
    assert ("not met" in found.sentence) is not is_met


@pytest.mark.parametrize(
    ("unit", "step_s", "values"),
    [
        ("degC", HOUR_S, None),  # the zero of a temperature is a convention
        ("K", HOUR_S, None),
        ("W", HOUR_S, [1.0, -1.0, 1.0, -1.0]),  # nothing is a share of a mean of zero
        ("kg/s", HOUR_S, None),  # neither energy nor power
        ("W", 24 * HOUR_S, None),  # neither hourly nor monthly
    ],
)
def test_nothing_is_said_where_there_are_no_limits(
    unit: str, step_s: float, values: list[float] | None
) -> None:
    found = judged(step_s, unit, [1.0] * 4, values)
    assert found.is_met is None
    assert guideline_sentence([found]) == ""
    assert found.to_dict()["is_met"] is None
