"""Rows that a search collects, and their coordinates."""

import numpy as np
from problems_for_tests import rc_problem

from studies.calibration.growing_rows import GrowingBasis, GrowingRows
from studies.calibration.processes.groups import ProcessGroups, is_refitted
from studies.calibration.processes.process import Features

RNG = np.random.default_rng(0)


def test_rows_are_kept_in_order_while_they_grow() -> None:
    rows, kept = RNG.standard_normal((40, 3)), GrowingRows(3)
    for first, end in ((0, 1), (1, 5), (5, 5), (5, 40)):
        kept.add(rows[first:end])
        np.testing.assert_array_equal(kept.rows, rows[:end])


def test_coordinates_keep_the_products_of_rows() -> None:
    # Rows of very different size, one that others make up, and the same once more.
    rows = RNG.standard_normal((12, 50)) * 10.0 ** RNG.uniform(-6.0, 6.0, (12, 1))
    rows[7] = rows[:3].sum(axis=0)
    rows[9] = rows[4]
    basis = GrowingBasis(50)
    basis.add(rows[:5])
    basis.add(rows[5:])
    found = basis.coordinates
    assert found.shape == (12, 10)
    size = np.linalg.norm(rows, axis=1)
    np.testing.assert_allclose(
        found @ found.T / np.outer(size, size), rows @ rows.T / np.outer(size, size), atol=1e-14
    )
    # Small differences between large rows keep their digits.
    np.testing.assert_allclose(np.linalg.norm(found[9] - found[4]), 0.0, atol=1e-14 * size[4])


def test_rows_that_are_not_finite_have_no_coordinates_and_spoil_no_others() -> None:
    rows = RNG.standard_normal((6, 8))
    rows[1, 3], rows[4, 0] = np.nan, np.inf
    basis = GrowingBasis(8)
    basis.add(rows)
    good = np.isfinite(rows).all(axis=1)
    assert basis.n_rows == 6
    assert np.isnan(basis.coordinates[~good]).all()
    np.testing.assert_allclose(basis.coordinates[good] @ basis.coordinates[good].T, rows[good] @ rows[good].T)


def test_a_process_through_coordinates_is_that_through_residuals() -> None:
    problem = rc_problem(noise=0.05)
    u, features = RNG.random((9, 2)), Features.of(problem.space)
    residuals = problem.residuals(u)
    basis = GrowingBasis(residuals.shape[1])
    basis.add(residuals)
    whole = ProcessGroups.fit(features, u, residuals)
    reduced = ProcessGroups.fit(features, u, basis.coordinates, n_residuals=residuals.shape[1])
    np.testing.assert_allclose(np.concatenate(reduced.hyper), np.concatenate(whole.hyper), atol=2e-4)
    anywhere = RNG.random((20, 2))
    np.testing.assert_allclose(reduced.errors(anywhere), whole.errors(anywhere), rtol=1e-3)


def test_hyperparameters_are_kept_where_few_rows_are_new() -> None:
    problem = rc_problem(noise=0.05)
    u, features = RNG.random((9, 2)), Features.of(problem.space)
    residuals = problem.residuals(u)
    first = ProcessGroups.fit(features, u[:8], residuals[:8])
    kept = ProcessGroups.fit(features, u, residuals, first.hyper, refits=False)
    np.testing.assert_array_equal(np.concatenate(kept.hyper), np.concatenate(first.hyper))
    # Every row counts up to 127, a fifth one at 320.
    assert all(is_refitted(n + 1, n) for n in range(127))
    assert not is_refitted(324, 320)
    assert is_refitted(325, 320)
