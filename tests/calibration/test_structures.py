"""What speaks for a structure: evidence, left-out blocks, white residuals, and the choice."""

from dataclasses import replace

import numpy as np
import pytest

from simulation.measurement import Measurement
from studies.calibration.prior import Prior
from studies.calibration.uncertainty.density import Posterior
from studies.calibration.uncertainty.information import covariance, half_widths, information, merit
from studies.calibration.uncertainty.noise import Noise
from studies.calibration.uncertainty.structures import (
    blocks_of,
    evidence,
    exceeded,
    left_out_losses,
    whiteness,
)
from studies.results.choice import Structure
from studies.stages.choose_stage import decided

M = 60
SPREAD = 0.5
"""Largest error of a logarithm of evidence: from seed to seed 300 particles spread by 0.3."""


@pytest.mark.parametrize("n_weak", [0, 2])
def test_the_evidence_is_that_of_the_exact_integral(n_weak: int) -> None:
    rng, p = np.random.default_rng(n_weak), 4
    slopes = 20.0 * rng.standard_normal((M, p))
    # The data hardly depend on these, so that the bounds cut the density.
    slopes[:, :n_weak] *= 0.002
    centre = np.full(p, 0.5)
    found = evidence(lambda u: (u - centre) @ slopes.T, _posterior(None), centre, seed=1)
    information_ = slopes.T @ slopes
    drawn = centre + rng.standard_normal((200_000, p)) @ np.linalg.cholesky(np.linalg.inv(information_)).T
    inside = np.mean(np.all((drawn > 0.0) & (drawn < 1.0), axis=1))
    exact = 0.5 * p * np.log(2.0 * np.pi) - 0.5 * np.linalg.slogdet(information_)[1] + np.log(inside)
    assert found.log == pytest.approx(exact, abs=SPREAD)
    assert found.error < 2.0 * SPREAD


def test_a_parameter_without_effect_costs_no_evidence_with_or_without_a_prior() -> None:
    rng = np.random.default_rng(7)
    slopes = 20.0 * rng.standard_normal((M, 2))
    small = evidence(lambda u: (u - 0.5) @ slopes.T, _posterior(None), np.full(2, 0.5), seed=1)
    prior = Prior(np.array([np.nan, np.nan, 0.2]), np.array([np.inf, np.inf, 0.3]), 1.0 / M, M)
    for known in (None, prior):
        large = evidence(lambda u: (u[:, :2] - 0.5) @ slopes.T, _posterior(known), np.full(3, 0.5), seed=1)
        assert large.log == pytest.approx(small.log, abs=SPREAD)


def test_blocks_are_predicted_without_having_been_seen() -> None:
    rng = np.random.default_rng(8)
    time = np.linspace(0.0, 1.0, M)
    y = 0.3 + 0.4 * time + 0.1 * rng.standard_normal(M)
    measurement = Measurement.on_grid(time, y[:, None], ("y",), np.array([0.1]))
    blocks = blocks_of(measurement)
    assert len(blocks) == 5
    np.testing.assert_array_equal(np.concatenate(blocks), np.arange(M))
    losses = left_out_losses(
        lambda u: u[:, :1] + u[:, 1:] * time - y, _posterior(None), np.full((1, 2), 0.5), blocks
    )
    for block, loss in zip(blocks, losses, strict=True):
        kept = np.setdiff1d(np.arange(M), block)
        slope, level = np.polyfit(time[kept], y[kept], 1)
        assert loss == pytest.approx(np.mean((level + slope * time[block] - y[block]) ** 2), rel=1e-3)


def test_white_residuals_differ_from_others() -> None:
    rng = np.random.default_rng(9)
    time, zero = np.arange(400.0), np.zeros((400, 1))
    white = rng.standard_normal(400)
    red = np.convolve(white, np.exp(-np.arange(20) / 4.0))[:400]
    found = [
        whiteness(Measurement.on_grid(time, one[:, None], ("y",), np.ones(1)), zero) for one in (white, red)
    ]
    assert found[0] > 0.01 > 1e-6 > found[1]


def test_chi_squared() -> None:
    # Quantiles of any table.
    assert exceeded(2.7055, 1) == pytest.approx(0.1, rel=1e-3)
    assert exceeded(7.8147, 3) == pytest.approx(0.05, rel=1e-3)


def test_the_choice_needs_probability_and_no_contradiction() -> None:
    small = _structure("small", 0.8, bic=0.0, left_out=(1.0, 1.1, 0.9))
    large = _structure("large", 0.2, bic=9.0, left_out=(1.0, 1.1, 0.9))
    assert decided([small, large])[0] == "small"
    # Less than 95 %, and BIC names the other one.
    assert decided([replace(small, bic=10.0), large])[0] == ""
    assert (
        decided([replace(small, bic=10.0, probability=0.97), replace(large, probability=0.03)])[0] == "small"
    )
    assert decided([replace(small, probability=0.6), replace(large, probability=0.4)])[0] == ""
    # What it predicts worse in every block, it is not chosen for.
    chosen, reason = decided([small, replace(large, left_out=(0.5, 0.61, 0.4))])
    assert not chosen
    assert "large predicts what was left out better" in reason


def test_a_new_measurement_adds_its_information_but_for_values_of_its_own() -> None:
    rng = np.random.default_rng(10)
    old, new = 5.0 * rng.standard_normal((2, M, 3))
    none, own = np.zeros(3, dtype=np.bool_), np.array([False, False, True])
    now = old.T @ old
    both = covariance(now + information(new, none), None)
    np.testing.assert_allclose(both, np.linalg.inv(now + new.T @ new + 12.0 * np.eye(3)))
    # With a fourth parameter in place of its own third one, whose covariance is then left out.
    whole = np.zeros((4, 4))
    whole[:3, :3] = now
    columns = np.column_stack([new[:, :2], np.zeros(M), new[:, 2]])
    whole += columns.T @ columns
    expected = np.linalg.inv(whole + 12.0 * np.eye(4))[:3, :3]
    found = covariance(now + information(new, own), None)
    np.testing.assert_allclose(found, expected)
    assert (half_widths(found) >= half_widths(both) - 1e-12).all()
    for criterion in ("half-widths", "A", "D"):
        assert merit(both, criterion) < merit(covariance(now, None), criterion)


def _posterior(prior: Prior | None) -> Posterior:
    return Posterior(Noise("sensor", 1.0, M, float(M)), prior)


def _structure(name: str, probability: float, *, bic: float, left_out: tuple[float, ...]) -> Structure:
    return Structure(
        case=name, label=name, n_parameters=2, determined=(), mse=1.0, aic=bic, bic=bic, log_evidence=0.0,
        log_evidence_error=0.0, probability=probability, left_out_mse=float(np.mean(left_out)),
        left_out=left_out, white=0.5, larger="", ratio_p=None, n_calls=5, n_judged=0, by_equations=True,
    )  # fmt: skip
