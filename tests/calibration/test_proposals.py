"""The points of a round: favourites, and those from which most is learnt."""

import numpy as np
from problems_for_tests import rc_problem
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.process import Features
from studies.calibration.search.expected_objective import ExpectedObjective
from studies.calibration.search.first_design import within
from studies.calibration.search.proposals import Surroundings, favourites, informative

N_ASKED, N_MORE = 2, 4


def surroundings(radius: float = 0.3) -> Surroundings:
    problem, u = rc_problem(noise=0.05), np.random.default_rng(0).random((12, 2))
    residuals = problem.residuals(u)
    process = ProcessGroups.fit(Features.of(ToyRC().parameter_space), u, residuals)
    centre: FloatArray = u[int(np.argmin((residuals**2).sum(axis=1)))]
    return Surroundings(ExpectedObjective(process), centre, radius, u, 3)


def proposed(around: Surroundings, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    asked, favourite = favourites(around, N_ASKED, rng)
    return asked, informative(around, asked, favourite, N_MORE, rng)


def test_they_teach_more_than_as_many_favourites() -> None:
    around = surroundings()
    lower, upper = within(around.centre, around.radius)
    places = np.random.default_rng(2).uniform(lower, upper, (50, 2))

    def left_unknown(points: FloatArray) -> float:
        n, covariance = len(points), around.objective.process.covariance(np.concatenate([points, places]))
        noise = 1e-6 * np.trace(covariance) * np.eye(n)
        known = np.linalg.solve(covariance[:n, :n] + noise, covariance[:n, n:])
        return float(np.trace(covariance[n:, n:] - covariance[n:, :n] @ known))

    liked, _ = favourites(around, N_ASKED + N_MORE, np.random.default_rng(0))
    assert left_unknown(np.concatenate(proposed(around, 0))) < 0.9 * left_unknown(liked)
