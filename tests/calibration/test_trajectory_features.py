"""Features of trajectories: blind for the phase, not for amplitude, period and mean."""

import numpy as np
import pytest

from simulation.arrays import FloatArray
from studies.calibration.search.trajectory_features import TrajectoryFeatures

TIME = np.linspace(0.0, 24.0, 400)
ALL = np.ones((1, TIME.size), dtype=np.bool_)


def saw_teeth(
    *, period: float = 1.1, amplitude: float = 1.0, phase: float = 0.0, mean: float = 20.0
) -> FloatArray:
    cycle = (TIME / period + phase) % 1.0
    return mean + amplitude * np.abs(cycle - 0.5)


MEASURED = saw_teeth()
FEATURES = TrajectoryFeatures(MEASURED, ALL)


def test_another_phase_is_nearly_as_good_where_residuals_are_as_bad_as_no_signal() -> None:
    shifted = saw_teeth(phase=0.5)
    assert np.mean((shifted - MEASURED) ** 2) > 2.0 * MEASURED.var()
    assert FEATURES.unexplained(shifted) < 0.01


@pytest.mark.parametrize("other", [{"period": 1.6}, {"amplitude": 1.4}, {"mean": 20.2}], ids=str)
def test_another_period_amplitude_or_mean_is_not(other: dict[str, float]) -> None:
    assert FEATURES.unexplained(saw_teeth(**other)) > 0.05


def test_outputs_count_apart() -> None:
    is_of = np.repeat(np.eye(2, dtype=np.bool_), 200, axis=1)
    two = np.concatenate([MEASURED[:200], 1e3 * MEASURED[200:]])
    assert TrajectoryFeatures(two, is_of).unexplained(np.concatenate([two[:200] + 0.2, two[200:]])) > 0.05
