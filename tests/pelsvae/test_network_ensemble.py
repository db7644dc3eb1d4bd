"""Networks beside the Gaussian processes: when they are tried, what they add, and that they last."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from rc_step_for_tests import PROCESSES, rc_step, waves

from pelsvae import ensemble_training, process_fitting
from pelsvae.ensemble_training import N_NETWORKS, NetworkTraining
from pelsvae.linear_vae import LinearVae
from pelsvae.network_ensemble import NetworkEnsemble
from pelsvae.side_by_side import SideBySide
from pelsvae.surrogate import Surrogate
from pelsvae.training import fit

N_WAVES = 50
FINITE_DIFFERENCE_TOL = 1e-4  # relative to the largest slope; central, with steps of 1e-5

Rows = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]


def noise(n: int, seed: int) -> Rows:
    random = np.random.default_rng(seed)
    return random.uniform(1.0, 2.0, size=(n, 2)), random.normal(size=(n, 3, 1))


def fitted(training: Rows, validation: Rows, seed: int = 0) -> Surrogate:
    return fit(*training, validation, config=PROCESSES.replace(max_epochs=5), seed=seed).surrogate


def network_of(surrogate: Surrogate) -> LinearVae:
    assert isinstance(surrogate.network, LinearVae)
    return surrogate.network


def error_of(surrogate: Surrogate, rows: Rows) -> float:
    return float(np.abs(surrogate.predict(rows[0]) - rows[1]).mean())


def trained_networks(features: torch.Tensor, codes: torch.Tensor, seed: int) -> NetworkEnsemble:
    return NetworkTraining(features, codes, seed, SideBySide(None)).result()


@pytest.fixture(scope="module")
def surrogate() -> Surrogate:
    # So few that processes leave two thirds of the squares; what they leave of 60 depends on the draw.
    made = fitted(waves(N_WAVES, seed=1), waves(60, seed=2))
    assert network_of(made).networks is not None
    return made


def test_what_shifts_in_time_is_learnt_better_than_by_processes_alone(
    surrogate: Surrogate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_fitting, "UNEXPLAINED", np.inf)
    alone = fitted(waves(N_WAVES, seed=1), waves(60, seed=2))
    assert network_of(alone).networks is None
    fresh = waves(300, seed=3)
    assert error_of(surrogate, fresh) < 0.9 * error_of(alone, fresh)


def test_networks_are_not_tried_where_processes_do_well() -> None:
    assert network_of(fitted(rc_step(60, seed=1), rc_step(40, seed=2))).networks is None


def test_networks_that_diverge_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble_training, "_LEARNING_RATE", 1e6)
    assert network_of(fitted(waves(N_WAVES, seed=1), waves(60, seed=2))).networks is None


def test_networks_that_explain_nothing_more_are_left_out() -> None:
    assert network_of(fitted(noise(40, seed=1), noise(300, seed=2))).networks is None


def test_mean_and_variance_are_those_of_processes_and_networks(surrogate: Surrogate) -> None:
    network = network_of(surrogate)
    networks = network.networks
    assert networks is not None
    theta = surrogate.theta_standardizer.features(torch.from_numpy(waves(9, seed=4)[0]), torch.float64)
    each = networks.each(theta)
    assert each.shape == (N_NETWORKS, 9, len(network.basis))
    torch.testing.assert_close(network.share.sum(dim=0) + networks.share, torch.ones_like(networks.share))
    kernel, codes = network.kernel, network.coefficients
    known = zip(network.hyper, network.share, codes, strict=True)
    processes = [share * (kernel.matrix(hyper, theta, network.x) @ solved) for hyper, share, solved in known]
    mean = torch.stack(processes).sum(dim=0) + networks.share * each.mean(dim=0)
    torch.testing.assert_close(network.regressor_mean(theta), mean, rtol=1e-6, atol=1e-6)
    with_networks = network.regressor_variance(theta)
    added = networks.share * (each - mean).square().mean(dim=0)
    assert (with_networks >= added).all()
    assert (added[:, networks.share > 0] > 0.0).all()


def test_bands_cover_what_they_claim(surrogate: Surrogate) -> None:
    theta, y = waves(300, seed=3)
    inside = np.abs(surrogate.predict(theta) - y) <= 1.6449 * surrogate.deviation(theta)
    assert inside.mean() == pytest.approx(0.9, abs=0.05)


def test_jacobian_equals_finite_differences(surrogate: Surrogate) -> None:
    theta = np.array([1.2, 2.5])
    jacobian = surrogate.jacobian(theta)[:, 0]
    exact = replace(surrogate, network=copy.deepcopy(surrogate.network).double())
    for place, step in enumerate(1e-5 * np.eye(2)):
        high, low = exact.predict(np.stack([theta + step, theta - step]))[:, :, 0]
        off = np.abs((high - low) / 2e-5 - jacobian[:, place])
        assert off.max() < FINITE_DIFFERENCE_TOL * np.abs(jacobian).max()


def test_loaded_surrogate_is_the_same_bit_for_bit(surrogate: Surrogate, tmp_path: Path) -> None:
    theta, _ = waves(50, seed=5)
    surrogate.save(tmp_path)
    loaded = Surrogate.load(tmp_path, device="cpu")
    np.testing.assert_array_equal(loaded.predict(theta), surrogate.predict(theta))
    np.testing.assert_array_equal(loaded.deviation(theta), surrogate.deviation(theta))
    np.testing.assert_array_equal(loaded.jacobian(theta[0]), surrogate.jacobian(theta[0]))


def test_same_seed_same_networks_and_other_seed_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble_training, "BATCH_ROWS", 32)  # two batches, the other rows in the next epoch
    monkeypatch.setattr(ensemble_training, "STEPS", 100)
    monkeypatch.setattr(ensemble_training, "EPOCHS", 1)
    random = np.random.default_rng(0)
    features = torch.from_numpy(random.normal(size=(70, 2)))
    codes = torch.stack([3.0 * features[:, 0] * features[:, 1], torch.sin(features[:, 0])], dim=1)
    first, again, other = (trained_networks(features, codes, seed).each(features) for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert (first.mean(dim=0) - codes).square().mean() < 0.05 * codes.square().mean()


def test_written_derivatives_are_those_of_automatic_differentiation() -> None:
    generator = torch.Generator().manual_seed(0)
    sizes = [(3, 5), (5, 4), (4, 2)]
    first = [torch.randn(2, i, o, generator=generator, dtype=torch.float64) for i, o in sizes]
    learnt, slopes = ensemble_training._Values.zeros(first), ensemble_training._Values.zeros(first)
    for flat in learnt.flat:
        flat.copy_(0.3 * torch.randn(flat.shape, generator=generator, dtype=torch.float64))
    x, y = (torch.randn(7, size, generator=generator, dtype=torch.float64) for size in (3, 2))
    deviation = torch.tensor([2.0, 0.5], dtype=torch.float64)
    ensemble_training._differentiate(learnt, slopes, x, y, deviation)

    values = [*learnt.weights, *learnt.biases, learnt.power, learnt.origin]
    layers = {f"weight_{place}": weight.requires_grad_() for place, weight in enumerate(learnt.weights)}
    layers |= {f"bias_{place}": bias.requires_grad_() for place, bias in enumerate(learnt.biases)}
    power, origin = learnt.power.requires_grad_(), learnt.origin.requires_grad_()
    networks = NetworkEnsemble({"share": torch.ones(2), "power": power, "origin": origin, **layers})
    (networks.each(x) * deviation - y).square().mean(dim=(1, 2)).sum().backward()  # type: ignore[no-untyped-call]
    written = [*slopes.weights, *slopes.biases, slopes.power, slopes.origin]
    for value, slope in zip(values, written, strict=True):
        torch.testing.assert_close(slope, value.grad)
