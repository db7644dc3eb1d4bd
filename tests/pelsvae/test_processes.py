"""The linear form: its kernel, its Gaussian processes against textbook formulas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from rc_step_for_tests import PROCESSES, rc_step
from scipy.optimize import check_grad

from pelsvae import linear_vae
from pelsvae.epochs import EpochReport
from pelsvae.kernel import CONSTANT, Kernel
from pelsvae.kernel_loss import kernel_loss
from pelsvae.kernel_search import ROWS
from pelsvae.linear_vae import LinearVae
from pelsvae.process_fitting import MANY_ROWS, MEMBER_ROWS
from pelsvae.surrogate_files import load_surrogate, save_surrogate
from pelsvae.training import FitResult, fit

# Forward differences with a step of 1.5e-8: half a second derivative of that, and cancellation of 1e-8.
GRADIENT_TOL = 1e-4
# Relative to the largest value: an inverse of a matrix of condition 1e10 in float64.
INVERSE_TOL = 1e-5


def fitted(
    n: int = 60, n_outputs: int = 2, seed: int = 0, n_validation: int = 40, **changes: object
) -> FitResult:
    config = PROCESSES.replace(**changes)
    validation = rc_step(n_validation, seed=2, n_outputs=n_outputs)
    return fit(*rc_step(n, seed=1, n_outputs=n_outputs), validation, config=config, seed=seed)


def network_of(result: FitResult) -> LinearVae:
    network = result.surrogate.network
    assert isinstance(network, LinearVae)
    return network


@pytest.mark.parametrize(("n_scales", "degree"), [(1, 1), (1, 2), (3, 1), (3, 2)])
def test_gradient_of_the_loss_equals_finite_differences(n_scales: int, degree: int) -> None:
    random = np.random.default_rng(3)
    kernel = Kernel(3, n_scales, degree)
    x, codes = torch.from_numpy(random.normal(size=(12, 3))), torch.from_numpy(random.normal(size=(12, 2)))
    mean, deviation = kernel.prior

    def loss(hyper: npt.NDArray[np.float64]) -> tuple[float, npt.NDArray[np.float64]]:
        return kernel_loss(kernel, hyper, x, codes, kernel.prior)

    # Not at the prior's noise: there rounding of the smallest eigenvalues is all that differences show.
    hyper = mean + 0.5 * deviation * random.normal(size=mean.size)
    hyper[-1] = -2.0
    off = check_grad(lambda h: loss(h)[0], lambda h: loss(h)[1], hyper)
    assert off < GRADIENT_TOL * np.linalg.norm(loss(hyper)[1])


def test_covariances_are_the_sums_that_the_module_states() -> None:
    random = np.random.default_rng(5)
    kernel = Kernel(2, 3, 2)
    mean, deviation = kernel.prior
    hyper = mean + 0.5 * deviation * random.normal(size=mean.size)
    x, others = random.normal(size=(3, 2)), random.normal(size=(4, 2))
    lengths, weights = np.exp(hyper[:6].reshape(3, 2)), np.exp([0.0, *hyper[6:8]])
    pairs = list(zip(weights, lengths, strict=True))
    warp, (slope, bend) = hyper[8:10], np.exp(2.0 * hyper[10:12])
    expected = np.empty((3, 4))
    for i, j in np.ndindex(3, 4):
        w, v = np.expm1(warp * x[i]) / warp, np.expm1(warp * others[j]) / warp
        product = (w * v / lengths[0] ** 2).sum()
        bumps = sum(b * np.exp(-0.5 * (((w - v) / length) ** 2).sum()) for b, length in pairs)
        expected[i, j] = CONSTANT + slope * product + bend * product**2 + bumps
    found = kernel.matrix(*(torch.from_numpy(values) for values in (hyper, x, others)))
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-12)


@pytest.mark.parametrize(("degree", "at_once"), [(1, 7), (2, 256)])
def test_the_mean_is_that_of_the_textbook(degree: int, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear_vae, "_TRAINING_ROWS_AT_ONCE", at_once)
    result = fitted(degree=degree)
    network, surrogate = network_of(result), result.surrogate
    _, y = rc_step(60, seed=1, n_outputs=2)
    fresh = 3.0 * rc_step(9, seed=4)[0]
    x = surrogate.theta_standardizer.features(torch.from_numpy(fresh), torch.float64)
    codes = torch.from_numpy(surrogate.output_standardizer.standardized(y)) @ network.basis.T
    means = []
    for hyper in network.hyper:
        noisy = network.kernel.noisy(hyper, network.x)
        across = network.kernel.matrix(hyper, x, network.x)
        solved = torch.linalg.solve(noisy, codes)
        means.append(across @ solved)
    share = network.share[:, None]
    assert torch.allclose(network.share.sum(dim=0), torch.ones(len(network.basis), dtype=torch.float64))
    mean = (share * torch.stack(means)).sum(dim=0)
    expected = surrogate.output_standardizer.physical((mean @ network.basis).numpy())
    scale = np.abs(y).max(axis=(0, 1))
    assert (np.abs(surrogate.predict(fresh) - expected) <= INVERSE_TOL * scale).all()


def test_what_is_linear_in_a_parameter_goes_on_beyond_the_box() -> None:
    random = np.random.default_rng(0)
    theta = random.uniform(1.0, 2.0, (20, 2))
    y = np.stack([3.0 * theta[:, 0] + theta[:, 1], theta[:, 0]], axis=1)[:, :, None]
    surrogate = fit(theta, y, (theta, y), config=PROCESSES.replace(theta_features="linear"), seed=0).surrogate
    assert surrogate.predict([[3.0, 1.5]])[0, :, 0] == pytest.approx([10.5, 3.0], rel=1e-3)


def test_same_seed_same_kernels_and_other_seed_others() -> None:
    first, again, other = (network_of(fitted(seed=seed)).hyper for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_members_are_averaged_while_rows_are_few() -> None:
    few = len(network_of(fitted(n=40, max_epochs=1)).hyper)
    assert 1 < len(network_of(fitted(n=400, max_epochs=1)).hyper) <= MEMBER_ROWS // 400 < few
    assert few <= PROCESSES.n_members
    assert len(network_of(fitted(n=40, max_epochs=1, n_members=2)).hyper) <= 2


def test_reports_end_with_the_surrogate_itself() -> None:
    reports: list[EpochReport] = []
    theta, y = rc_step(2 * ROWS[0], seed=1)
    result = fit(theta, y, rc_step(20, seed=2), config=PROCESSES, seed=0, on_epoch=reports.append)
    epochs = [report.epoch for report in reports]
    assert epochs == sorted(set(epochs))
    assert (epochs[-1], result.best_epoch, result.n_epochs) == (PROCESSES.max_epochs,) * 3
    theta, y = rc_step(20, seed=2)
    assert reports[-1].validation_mae == pytest.approx(np.abs(result.surrogate.predict(theta) - y).mean())
    # Rows that are added are known better than the first ones were.
    assert reports[-1].train_loss < reports[0].train_loss


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device on this machine")
@pytest.mark.parametrize("n", [64, MANY_ROWS])
def test_cuda_fits_and_predicts_like_the_cpu(n: int, tmp_path: Path) -> None:
    theta, _ = rc_step(20, seed=3, n_outputs=2)
    cpu, cuda = (fitted(n=n, max_epochs=2, device=device).surrogate for device in ("cpu", "cuda"))
    expected = cpu.predict(theta)
    assert np.abs(cuda.predict(theta) - expected).max() <= 1e-2 * np.abs(expected).max()
    save_surrogate(cuda, tmp_path)
    again = load_surrogate(tmp_path, device="cpu")
    assert again.predict(theta) == pytest.approx(cuda.predict(theta), rel=1e-6)


@pytest.mark.parametrize("n", [1, 2])
def test_next_to_nothing_to_learn_from(n: int) -> None:
    theta, y = rc_step(n, seed=1)
    surrogate = fit(theta, y, rc_step(5, seed=2), config=PROCESSES, seed=0).surrogate
    assert np.isfinite(surrogate.predict(rc_step(5, seed=3)[0])).all()
    np.testing.assert_allclose(surrogate.predict(theta), y, rtol=1e-2)


def test_trajectories_that_are_all_alike_are_learnt() -> None:
    theta, y = rc_step(12, seed=1)
    alike = np.broadcast_to(y[:1], y.shape)
    surrogate = fit(theta, alike, (theta, alike), config=PROCESSES, seed=0).surrogate
    np.testing.assert_array_equal(surrogate.predict(theta), alike)
