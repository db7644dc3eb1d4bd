"""Whether a model switches at times that depend on its parameters."""

import numpy as np
import pytest

from simulation.arrays import FloatArray
from studies.calibration.search.switching import switches

TIME = np.linspace(0.0, 10.0, 300)


def heated(periods: FloatArray) -> FloatArray:
    """Saw teeth of a heater that a thermostat switches, of so many periods each. Shape (n, t)."""
    return np.abs(TIME % periods[:, None] - 0.5 * periods[:, None]) / periods[:, None]


def driven(gains: FloatArray) -> FloatArray:
    """Slow answers to a schedule that jumps at the same times for all, with so many gains. Shape (n, t)."""
    schedule = (TIME % 2.0 < 1.0).astype(float)
    return gains[:, None] * np.cumsum(schedule) / TIME.size + np.sin(TIME / gains[:, None])


def test_kinks_that_move_with_the_parameters_are_switches() -> None:
    assert switches(heated(np.linspace(0.9, 2.3, 8)))


@pytest.mark.parametrize(
    "trajectories",
    [
        driven(np.linspace(0.5, 3.0, 8)),
        np.sin(np.linspace(1.0, 9.0, 8)[:, None] * TIME),
        np.zeros((8, TIME.size)),
        heated(np.full(8, 1.3)),
        heated(np.array([1.3])),
        np.ones((8, 3)),
    ],
    ids=["a schedule", "waves", "nothing moves", "the same kinks", "a single row", "three samples"],
)
def test_kinks_of_inputs_and_smooth_motion_are_none(trajectories: FloatArray) -> None:
    assert not switches(trajectories)
