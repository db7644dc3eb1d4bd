"""Robust losses: gross outliers in a recording, and what they do to calibrated parameters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulation.arrays import FloatArray
from simulation.case import Case, load_case
from simulation.measurement import Measurement
from simulation.robust_loss import LossKind, RobustLoss
from studies.calibration.adaptive import Adaptive, AdaptiveResult
from studies.calibration.learned_ode import LearnedODE
from studies.calibration.problem import CalibrationProblem
from studies.calibration.states import StateSignals, WatchedModel, watching_states
from studies.uncertainty.identifiability import judged_slopes
from studies.uncertainty.noise import noise_of

WALL = Path(__file__).parents[2] / "fmus" / "wall"
OUTLIERS, SIZE = 0.05, 40.0
"""Share of samples that are wrong, and by how many standard uncertainties."""
# Normal: 90 % of the probability lies within so many standard deviations.
HALF_WIDTH = 1.645


@pytest.fixture(scope="module")
def wall() -> Case:
    return load_case(WALL)


def with_outliers(measurement: Measurement, seed: int) -> Measurement:
    rng, samples = np.random.default_rng(seed), []
    for one, sensor in zip(measurement.samples, measurement.uncertainty, strict=True):
        values = one.values.copy()
        wrong = rng.choice(len(values), round(OUTLIERS * len(values)), replace=False)
        values[wrong] += rng.choice([-1.0, 1.0], len(wrong)) * SIZE * sensor
        samples.append(replace(one, values=values))
    return replace(measurement, samples=tuple(samples))


def calibrated(case: Case, measurement: Measurement, max_calls: int = 5) -> AdaptiveResult:
    with watching_states(case).open_model() as model:
        problem = CalibrationProblem(WatchedModel(model, StateSignals.of(case)), measurement)
        return Adaptive(max_calls=max_calls, misfit_threshold=np.inf).minimize(
            problem, seed=0, learned_ode=LearnedODE.of(problem)
        )


def half_width(case: Case, found: AdaptiveResult) -> FloatArray:
    assert found.slopes is not None
    names = case.parameter_space.names
    noise = noise_of("correlated", case.measurement, found.y, len(names))
    return HALF_WIDTH * judged_slopes(names, found.slopes, noise.raised).spread


@pytest.mark.parametrize("kind", ["huber", "soft-l1"])
@pytest.mark.parametrize("seed", [0, 1])
def test_outliers_move_the_parameters_by_less_than_half_their_interval_and_squares_do_not(
    wall: Case, kind: LossKind, seed: int
) -> None:
    clean = calibrated(wall, wall.measurement)
    wrong = with_outliers(wall.measurement, seed)
    robust = tuple(RobustLoss(kind, 2.0 * float(sensor)) for sensor in wrong.uncertainty)
    moved = {
        name: np.abs(calibrated(wall, replace(wrong, losses=losses)).u - clean.u) / half_width(wall, clean)
        for name, losses in (("squares", ()), ("robust", robust))
    }
    print(kind, seed, {k: np.round(v, 2) for k, v in moved.items()})
    assert (moved["robust"] < 1.0).all()
    assert (moved["squares"] > 1.0).any()
