"""What is tested before a search has converged, and where."""

from functools import partial

import numpy as np
import pytest

from simulation.arrays import FloatArray
from studies.calibration.confirmation import least_unlikely
from studies.calibration.ending import CONFIRMED, FEW_PARAMETERS, N_TESTED, N_TESTED_MORE, Confirmation
from studies.calibration.residual_process import Expansion


def valley(u: FloatArray, *, caution: float, unsure_at: float) -> Expansion:
    """A valley along the second coordinate, lowest at 0.5; the surrogate is unsure in one part of it."""
    mse = 1.0 + 50.0 * (u[0] - 0.5) ** 2 + 0.01 * (u[1] - 0.5) ** 2
    variance = 0.02 * float(abs(abs(u[1] - 0.5) - unsure_at) < 0.1)
    slope = np.array([100.0 * (u[0] - 0.5), 0.02 * (u[1] - 0.5)])
    return Expansion(mse + caution * variance, mse, slope, np.diag([100.0, 0.02]))


def places(
    unsure_at: float, n: int, rows: FloatArray, good: tuple[bool, ...], seed: int
) -> tuple[FloatArray, float]:
    best = np.array([0.5, 0.5])
    expand = partial(valley, unsure_at=unsure_at)
    return least_unlikely(expand, (best, 1.0), (rows, np.array(good)), n, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(3))
def test_a_lower_error_is_least_unlikely_along_the_valley_where_the_surrogate_is_unsure(seed: int) -> None:
    ((found,), _) = places(0.2, 1, np.array([[0.5, 0.5]]), (True,), seed)
    assert found[0] == pytest.approx(0.5, abs=0.02)
    assert 0.1 <= abs(found[1] - 0.5) <= 0.3


def test_where_the_nearest_row_failed_is_asked_last() -> None:
    rows = np.array([[0.5, 0.5], [0.5, 0.8]])
    ((found,), _) = places(0.2, 1, rows, (True, False), 0)
    assert np.abs(found - rows[0]).max() <= np.abs(found - rows[1]).max()


def test_as_many_places_as_asked_for() -> None:
    assert places(0.2, 40, np.array([[0.5, 0.5]]), (True,), 0)[0].shape == (40, 2)


def test_a_gain_that_a_test_has_found_makes_more_tests_owed() -> None:
    confirmation = Confirmation(FEW_PARAMETERS + 1, 1)
    confirmation.note_best(1.0)
    confirmation.n_tested, confirmation.n_restarts = 2, 1
    confirmation.note_best(1.0 - 0.5 * CONFIRMED)
    assert (confirmation.n_tested, confirmation.tests_owed, confirmation.restarts_owed) == (2, N_TESTED, 1)
    # Small gains add up.
    confirmation.note_best(1.0 - 1.5 * CONFIRMED)
    assert confirmation.n_tested == confirmation.n_restarts == 0
    assert (confirmation.tests_owed, confirmation.restarts_owed) == (N_TESTED + N_TESTED_MORE, 2)


def test_who_never_leaves_owes_no_restarts() -> None:
    assert Confirmation(2, 0).restarts_owed == 0
