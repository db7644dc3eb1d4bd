"""What is tested before a search has converged, and where."""

import numpy as np
from problems_for_tests import TRUE_RC, rc_problem
from scipy.optimize import approx_fprime
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.posterior_sample import PosteriorSample
from studies.calibration.processes.process import Features
from studies.calibration.search.confirmation import (
    N_DRAWN,
    PROMISED,
    RESTARTS_OWED,
    Confirmation,
    least_unlikely,
)
from studies.calibration.search.ending import after_tests, still_owed
from studies.calibration.search.expected_objective import ExpectedObjective
from studies.calibration.search.rows import Incumbent

FEATURES = Features.of(ToyRC().parameter_space)
# Differences of 1e-6 in the cube leave about 1e-6 of the gradient.
GRADIENT_RTOL = 1e-4


def taught(n: int, seed: int = 0) -> tuple[ProcessGroups, FloatArray, FloatArray]:
    problem = rc_problem(noise=0.05)
    u = np.random.default_rng(seed).random((n, 2))
    return ProcessGroups.fit(FEATURES, u, problem.residuals(u)), u, problem.mse(u)


def test_the_gradient_of_a_drawn_function_is_that_of_its_value() -> None:
    process, _, _ = taught(12)
    sample = PosteriorSample.draw(process, np.random.default_rng(3))
    for point in np.random.default_rng(5).random((5, 2)):
        numeric = approx_fprime(point, lambda v: sample.expand(v).value, 1e-7)
        gradient = sample.expand(point).gradient
        np.testing.assert_allclose(gradient, numeric, rtol=GRADIENT_RTOL, atol=1e-4 * np.abs(gradient).max())


def test_nothing_is_promised_at_the_minimum_and_much_away_from_it() -> None:
    process, u, mse = taught(40)
    lowest = int(mse.argmin())
    best = Incumbent(lowest, u[lowest], float(mse[lowest]))
    rng = np.random.default_rng(1)
    _, away = least_unlikely(ExpectedObjective(process), best, (u, np.ones(40, dtype=np.bool_)), 1, rng)
    assert np.median(away) > PROMISED
    problem = rc_problem(noise=0.05)
    at = LeastSquaresTRF().minimize(problem, problem.space.to_unit(TRUE_RC)).u
    rng = np.random.default_rng(0)
    around = np.clip(at + 0.05 * rng.standard_normal((10, 2)), 0.0, 1.0)
    u = np.concatenate([rng.random((30, 2)), around, at[None]])
    process = ProcessGroups.fit(FEATURES, u, problem.residuals(u))
    best, rows = Incumbent(40, at, float(problem.mse(at)[0])), (u, np.ones(41, dtype=np.bool_))
    _, gains = least_unlikely(ExpectedObjective(process), best, rows, 1, rng)
    assert np.median(gains) < PROMISED


def test_what_is_promised_and_not_found_is_said() -> None:
    """After all tests and restarts that are owed, none of which gains anything."""
    confirmation = Confirmation()
    for n_restarts in range(RESTARTS_OWED + 1):
        confirmation.n_restarts = n_restarts
        assert not confirmation.is_tested
        confirmation.note_test(np.full(N_DRAWN, 2.0 * PROMISED))
        assert confirmation.is_tested
    assert confirmation.has_looked
    assert not after_tests(confirmation, switches=False).converged
    said = f"a gain of up to {200.0 * PROMISED:g} % of the error is not excluded beside it"
    assert said in still_owed(confirmation, 1e-3)
