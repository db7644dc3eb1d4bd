"""Robust losses: gross outliers in a recording, and what they do to calibrated parameters."""

from dataclasses import replace

import numpy as np
import pytest
from measurement_for_tests import with_each, with_samples
from moving_for_tests import FMUS, watched_case, with_equations
from problems_for_tests import rc_problem
from scipy.optimize import least_squares

from simulation.arrays import FloatArray
from simulation.case import Case, load_case
from simulation.measurement import Measurement
from simulation.robust_loss import LossKind, RobustLoss
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult
from studies.calibration.uncertainty.identifiability import judged_slopes
from studies.calibration.uncertainty.noise import noise_of

WALL = FMUS / "wall"
OUTLIERS, SIZE = 0.05, 40.0
"""Share of samples that are wrong, and by how many standard uncertainties."""
# Normal: 90 % of the probability lies within so many standard deviations.
HALF_WIDTH = 1.645


@pytest.fixture(scope="module")
def wall() -> Case:
    return load_case(WALL)


@pytest.fixture(scope="module")
def clean(wall: Case) -> AdaptiveResult:
    return calibrated(wall.measurement)


def with_outliers(measurement: Measurement, seed: int) -> Measurement:
    rng, samples = np.random.default_rng(seed), []
    for one in measurement.outputs:
        values = one.samples.values.copy()
        wrong = rng.choice(len(values), round(OUTLIERS * len(values)), replace=False)
        values[wrong] += rng.choice([-1.0, 1.0], len(wrong)) * SIZE * one.uncertainty
        samples.append(replace(one.samples, values=values))
    return with_samples(measurement, samples)


def calibrated(measurement: Measurement) -> AdaptiveResult:
    with watched_case(WALL) as (_, problem):
        # Without a threshold, squares too are minimized within five calls.
        problem = replace(problem, measurement=measurement)
        found, _ = with_equations(problem, max_calls=5, misfit_threshold=np.inf)
    assert found.converged
    return found


def half_width(case: Case, measurement: Measurement, found: AdaptiveResult) -> FloatArray:
    assert found.slopes is not None
    names = case.parameter_space.names
    noise = noise_of("correlated", measurement, found.y, len(names))
    return HALF_WIDTH * judged_slopes(names, found.slopes, noise.raised).spread


@pytest.mark.parametrize(("kind", "seed"), [("huber", 0), ("soft-l1", 1)])
def test_outliers_move_parameters_by_less_than_half_their_interval_where_squares_do_not(
    wall: Case, clean: AdaptiveResult, kind: LossKind, seed: int
) -> None:
    wrong, widths = with_outliers(wall.measurement, seed), half_width(wall, wall.measurement, clean)
    outputs = tuple(replace(one, loss=RobustLoss(kind, 2.0 * one.uncertainty)) for one in wrong.outputs)
    robust = replace(wrong, outputs=outputs)
    found, by_squares = calibrated(robust), calibrated(wrong)
    assert (np.abs(found.u - clean.u) < widths).all()
    assert (np.abs(by_squares.u - clean.u) > widths).any()
    # What is said of its certainty does not suffer from the outliers either.
    ratios = half_width(wall, robust, found) / widths
    assert ((ratios > 0.8) & (ratios < 1.5)).all()
    assert (half_width(wall, wrong, by_squares) > 3.0 * widths).all()


@pytest.mark.parametrize("kind", ["huber", "soft-l1"])
def test_the_likelihood_is_as_wide_as_robust_means_scatter(kind: LossKind) -> None:
    rng, m, n, step = np.random.default_rng(0), 100, 2000, 0.1
    wrong = rng.random((n, m)) < OUTLIERS
    y = np.where(wrong, 10.0 * rng.choice([-1.0, 1.0], (n, m)), rng.normal(size=(n, m)))
    loss, means = RobustLoss(kind, 1.5), np.zeros((n, 1))
    for _ in range(50):
        # Least squares with weights of psi by the difference ends where the loss is least.
        size = np.abs(y - means) / loss.scale
        weights = 1.0 / np.maximum(size, 1.0) if kind == "huber" else 1.0 / np.hypot(1.0, size)
        means = np.sum(weights * y, axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
    widths = []
    for row, (mean,) in zip(y[:200], means, strict=False):
        # A sensor of less than the noise: else its declared uncertainty would be the noise.
        measurement = Measurement.on_grid(600.0 * np.arange(m), row[:, None], ("y",), np.array([0.5]))
        measurement = with_each(measurement, loss=loss)
        noise = noise_of("white", measurement, np.full((m, 1), mean), 1)
        beside = np.array([mean - step, mean, mean + step])[:, None, None] + np.zeros((m, 1))
        below, at, above = noise.log_likelihood(measurement.mse(beside))
        widths.append(step / np.sqrt(2.0 * at - below - above))
    assert np.median(widths) == pytest.approx(means.std(), rel=0.05)


@pytest.mark.parametrize(("kind", "scipys"), [("huber", "huber"), ("soft-l1", "soft_l1")])
def test_every_method_finds_the_point_of_scipys_robust_least_squares(kind: LossKind, scipys: str) -> None:
    clean = rc_problem(noise=0.1)
    plain = replace(clean, measurement=with_outliers(clean.measurement, 0))
    robust = replace(plain, measurement=with_each(plain.measurement, loss=RobustLoss(kind, 0.2)))
    start = np.array([0.4, 0.6])
    expected = least_squares(
        lambda u: plain.residuals(u)[0], start, bounds=(0.0, 1.0), loss=scipys, f_scale=0.2, xtol=1e-12
    )
    assert np.abs(expected.x - LeastSquaresTRF().minimize(plain, start).u).max() > 0.01
    mean_loss = 2.0 * expected.cost / robust.measurement.n_samples
    # The error is flat around its least value: points differ by more than errors.
    for found, tolerance in (
        (LeastSquaresTRF(ftol=1e-12).minimize(robust, start), 1e-5),
        (DifferentialEvolution().minimize(robust, seed=0), 1e-3),
        (Adaptive(max_calls=60).minimize(robust, seed=0), 1e-2),
    ):
        np.testing.assert_allclose(found.u, expected.x, atol=tolerance)
        assert found.mse == pytest.approx(mean_loss, rel=1e-3)
