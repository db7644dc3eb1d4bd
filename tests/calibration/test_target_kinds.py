"""Correlated errors and limits: every method minimizes them, and the posterior is as wide as it should be."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from measurement_for_tests import with_each
from problems_for_tests import rc_problem
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from simulation.arrays import FloatArray
from simulation.limits import Limits
from simulation.measurement import Measurement
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.uncertainty.noise import noise_of

SIZE, LASTS_S = 0.3, 4.0 * 3600.0
START = np.array([0.4, 0.6])


def correlated(problem: CalibrationProblem) -> tuple[CalibrationProblem, Callable[[FloatArray], FloatArray]]:
    """Return the problem with a correlation time, and its residuals by the factor of the whole matrix."""
    samples = problem.measurement.outputs[0].samples
    matrix = np.exp(-np.abs(samples.time[:, None] - samples.time) / LASTS_S)
    factor = cholesky(matrix, lower=True)
    return (
        replace(problem, measurement=with_each(problem.measurement, correlation_s=LASTS_S)),
        lambda u: np.asarray(solve_triangular(factor, problem.residuals(u)[0], lower=True)),
    )


def limited(problem: CalibrationProblem) -> tuple[CalibrationProblem, Callable[[FloatArray], FloatArray]]:
    """Return the problem with a limit that the measurement breaks, and its residuals."""
    time, y = problem.measurement.time, problem.measurement.y[:, 0]
    limit = float(np.quantile(y, 0.7))

    def residuals(u: FloatArray) -> FloatArray:
        simulated = problem.evaluate(u).y[0, :, 0]
        return np.concatenate([simulated - y, np.maximum(simulated - limit, 0.0)])

    limits = Limits(time, -np.inf, limit, is_alone=False)
    return replace(problem, measurement=with_each(problem.measurement, limits=limits)), residuals


@pytest.mark.parametrize("kind", [correlated, limited])
def test_every_method_finds_the_point_of_scipys_least_squares(kind: Callable[..., object]) -> None:
    plain = rc_problem(noise=SIZE)
    problem, residuals = kind(plain)  # type: ignore[misc]
    expected = least_squares(residuals, START, bounds=(0.0, 1.0), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert np.abs(expected.x - LeastSquaresTRF().minimize(plain, START).u).max() > 1e-3
    mse = 2.0 * expected.cost / plain.measurement.n_samples
    # The error is flat around its least value: points differ by more than errors.
    for found, tolerance in (
        (LeastSquaresTRF(ftol=1e-12).minimize(problem, START), 1e-5),
        (DifferentialEvolution().minimize(problem, seed=0), 1e-3),
        (Adaptive(max_calls=60).minimize(problem, seed=0), 1e-2),
    ):
        np.testing.assert_allclose(found.u, expected.x, atol=tolerance)
        # A search on a Gaussian process ends where it expects little gain; limits have kinks.
        assert found.mse == pytest.approx(mse, rel=5e-3 if tolerance == 1e-2 else 1e-4)


def test_the_likelihood_of_correlated_errors_is_as_wide_as_their_means_scatter() -> None:
    m, n, step, rng = 100, 1000, 0.01, np.random.default_rng(0)
    time = 600.0 * np.arange(m)
    matrix = np.exp(-np.abs(time[:, None] - time) / LASTS_S)
    y = rng.normal(size=(n, m)) @ cholesky(matrix)
    ones = np.linalg.solve(matrix, np.ones(m))
    means = y @ ones / ones.sum()
    plain = Measurement.on_grid(time, y[0][:, None], ("y",), np.ones(1))
    declared = with_each(plain, correlation_s=LASTS_S)
    widths = {}
    for name, measurement in (("plain", plain), ("declared", declared)):
        noise = noise_of("sensor", measurement, np.full((m, 1), means[0]), 1)
        beside = means[0] + step * np.array([-1.0, 0.0, 1.0])[:, None, None] + np.zeros((m, 1))
        below, at, above = noise.log_likelihood(measurement.mse(beside))
        widths[name] = step / np.sqrt(2.0 * at - below - above)
    # 1,000 means show their deviation to 2 %.
    assert widths["declared"] == pytest.approx(means.std(), rel=0.07)
    assert widths["plain"] < 0.4 * means.std()


def test_limits_that_are_kept_change_no_noise() -> None:
    problem = rc_problem(noise=SIZE)
    measurement, y = problem.measurement, problem.evaluate(START).y[0]
    kept = Limits(measurement.time, -1e6, 1e6, is_alone=False)
    limited_too = with_each(measurement, limits=kept)
    for kind in ("correlated", "white", "sensor"):
        one, other = (noise_of(kind, target, y, 2) for target in (measurement, limited_too))  # type: ignore[arg-type]
        assert other.deviation == pytest.approx(one.deviation, rel=1e-12)
        assert other.n_independent == pytest.approx(one.n_independent, rel=1e-12)
        assert other.raised**2 / other.n_samples == pytest.approx(one.raised**2 / one.n_samples, rel=1e-12)
