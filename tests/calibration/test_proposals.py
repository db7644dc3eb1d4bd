"""The points of a round: favourites, and those from which most is learnt."""

import numpy as np
import pytest
from problems_for_tests import rc_problem
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from studies.calibration.process_groups import ProcessGroups
from studies.calibration.proposals import Surroundings, favourites, informative
from studies.calibration.residual_process import Features
from studies.calibration.search_constants import SEARCH

N_ASKED, N_MORE = 2, 4


def surroundings(radius: float = 0.3) -> Surroundings:
    problem, u = rc_problem(noise=0.05), np.random.default_rng(0).random((12, 2))
    residuals = problem.residuals(u)
    process = ProcessGroups.fit(Features.of(ToyRC().parameter_space), u, residuals)
    centre: FloatArray = u[int(np.argmin((residuals**2).sum(axis=1)))]
    return Surroundings(process, None, centre, radius, u, 3)


def proposed(around: Surroundings, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    asked, favourite = favourites(around, N_ASKED, rng)
    return asked, informative(around, asked, favourite, N_MORE, rng)


def test_more_points_may_be_asked_together_than_places_are_usually_drawn() -> None:
    around, rng = surroundings(), np.random.default_rng(0)
    asked, favourite = favourites(around, 1, rng)
    assert informative(around, asked, favourite, 240, rng).shape == (240, 2)


def test_the_favourite_is_the_lowest_expectation_in_the_trust_region() -> None:
    around = surroundings()
    asked, favourite = favourites(around, 1, np.random.default_rng(0))
    assert around.objectives(asked)[0] == pytest.approx(favourite.mse)
    lower, upper = around.box(around.radius)
    others = np.random.default_rng(1).uniform(lower, upper, (500, 2))
    assert favourite.value <= min(around.expand(u, SEARCH.caution).value for u in others) * (1.0 + 1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_points_that_teach_lie_apart_in_the_trust_region_where_the_error_may_be_as_low(seed: int) -> None:
    around = surroundings()
    asked, more = proposed(around, seed)
    lower, upper = around.box(around.radius)
    assert ((lower <= more) & (more <= upper)).all()
    apart = np.abs(more[:, None] - np.concatenate([asked, more])).max(axis=-1)
    assert np.sort(apart, axis=1)[:, 1].min() > 1e-3  # the nearest is the point itself
    allowed = around.objectives(asked[:1]) + 2.0 * SEARCH.most_spread * around.objectives(around.centre[None])
    assert (around.objectives(more) <= allowed).all()


def test_they_teach_more_than_as_many_favourites() -> None:
    around = surroundings()
    lower, upper = around.box(around.radius)
    places = np.random.default_rng(2).uniform(lower, upper, (50, 2))

    def left_unknown(points: FloatArray) -> float:
        n, covariance = len(points), around.process.covariance(np.concatenate([points, places]))
        noise = 1e-6 * np.trace(covariance) * np.eye(n)
        known = np.linalg.solve(covariance[:n, :n] + noise, covariance[:n, n:])
        return float(np.trace(covariance[n:, n:] - covariance[n:, :n] @ known))

    liked, _ = favourites(around, N_ASKED + N_MORE, np.random.default_rng(0))
    assert left_unknown(np.concatenate(proposed(around, 0))) < 0.9 * left_unknown(liked)


def test_a_perfect_and_certain_surrogate_still_proposes_points() -> None:
    u = np.random.default_rng(0).random((6, 2))
    process = ProcessGroups.fit(Features.of(ToyRC().parameter_space), u, np.zeros((6, 5)))
    _, more = proposed(Surroundings(process, None, u[0], 0.3, u, 3), 0)
    assert np.isfinite(more).all()
    assert more.shape == (N_MORE, 2)
