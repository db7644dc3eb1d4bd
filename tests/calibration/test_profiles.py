"""Profile likelihoods: crossings as brute force finds them, bounds that are reached, priors."""

import numpy as np
import pytest

from simulation.arrays import FloatArray
from studies.calibration.prior import Prior
from studies.calibration.uncertainty.profiles import LIMIT, profiles

NOISE, N_TIMES = 0.05, 40
TIME = np.linspace(0.0, 3.0, N_TIMES)
CROSSING = 0.05
"""Largest difference of an interval's end from that of brute force, as a share of half the interval."""


def decay(u: FloatArray) -> FloatArray:
    """Return an amplitude that decays; errors are low along a bent line of the two parameters."""
    return np.asarray((0.2 + 2.0 * u[:, :1]) * np.exp(-(0.1 + 3.0 * u[:, 1:]) * TIME))


def product(u: FloatArray) -> FloatArray:
    """Return a constant that only the product of both parameters decides."""
    return np.asarray((0.2 + u[:, :1]) * (0.2 + u[:, 1:]) * np.ones(N_TIMES))


def brute_force(measured: FloatArray, j: int, n: int = 501) -> tuple[float, float]:
    """Return the ends of a profile's interval by a grid of both parameters."""
    grid = np.linspace(0.0, 1.0, n)
    least = np.empty(n)
    for k, value in enumerate(grid):
        u = np.full((n, 2), value)
        u[:, 1 - j] = grid
        least[k] = np.mean((decay(u) - measured) ** 2, axis=1).min()
    roots = np.sqrt((least - least.min()) * N_TIMES) / NOISE
    lowest = int(np.argmin(roots))
    # Both halves rise, so that a crossing between two values of the grid is interpolated.
    low = np.interp(LIMIT, roots[lowest::-1], grid[lowest::-1])
    return float(low), float(np.interp(LIMIT, roots[lowest:], grid[lowest:]))


@pytest.mark.parametrize("seed", [3, 4])
def test_crossings_are_those_of_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = 0.3 + 0.4 * rng.random((1, 2))
    measured = decay(truth)[0] + NOISE * rng.standard_normal(N_TIMES)
    # Begun with widths that are ten times too small: only steps depend on them.
    found = profiles(lambda u: decay(u) - measured, None, truth[0], np.full(2, 0.003), NOISE**2 / N_TIMES)
    assert not found.is_open.any()
    for j in (0, 1):
        ends = brute_force(measured, j)
        half = 0.5 * (ends[1] - ends[0])
        np.testing.assert_allclose(found.ends[:, j], ends, atol=CROSSING * half)
        # The other parameter is at its best there, not where it was.
        assert np.abs(found.points[:, j, 1 - j] - found.best[1 - j]).min() > 0.1 * half
    # A profile rises from the best point to both sides.
    for at, roots in zip(found.at, found.roots, strict=True):
        is_known = np.isfinite(at)
        assert (np.diff(at[is_known]) >= 0.0).all()
        assert roots[is_known].min() < 0.05


def test_a_ridge_reaches_the_bounds_and_takes_the_other_parameter_along() -> None:
    rng = np.random.default_rng(5)
    measured = 0.49 + NOISE * rng.standard_normal(N_TIMES)
    best = np.array([0.5, 0.5])
    found = profiles(lambda u: product(u) - measured, None, best, np.full(2, 0.4), NOISE**2 / N_TIMES)
    # The product is about 0.49: with the other one at 1.2, each is 0.41 at least.
    assert found.is_open[1].all()
    assert (found.ends[1] == 1.0).all()
    assert not found.is_open[0].any()
    low = found.points[0]
    assert low[0, 1] == pytest.approx(1.0)
    assert low[1, 0] == pytest.approx(1.0)


def test_a_prior_narrows_a_profile() -> None:
    rng = np.random.default_rng(6)
    measured = 0.49 + NOISE * rng.standard_normal(N_TIMES)
    unit, best = NOISE**2 / N_TIMES, np.array([0.5, 0.5])
    prior = Prior(np.array([0.5, np.nan]), np.array([0.05, np.inf]), unit, N_TIMES)
    found = profiles(lambda u: product(u) - measured, prior, best, np.full(2, 0.1), unit)
    assert not found.is_open.any()
    # Of the first one the prior is nearly all that is known: 1.645 of its deviations.
    np.testing.assert_allclose(found.ends[:, 0], 0.5 + LIMIT * np.array([-0.05, 0.05]), atol=0.005)
