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
from pelsvae.kernel import Kernel
from pelsvae.kernel_loss import kernel_loss
from pelsvae.linear_vae import LinearVae
from pelsvae.process_fitting import MANY_ROWS
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


def test_same_seed_same_kernels_and_other_seed_others() -> None:
    first, again, other = (network_of(fitted(24, max_epochs=3, seed=seed)).hyper for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


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
