"""A decoder that knows the inputs: its mathematics against SciPy, and what it learns from few rows."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from rc_step_for_tests import alone
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pelsvae import VARIANTS, Surrogate, fit, load_surrogate, save_surrogate
from pelsvae.linear_network import kernels
from pelsvae.linear_network.drive import Drive
from pelsvae.linear_network.form import Form, modes, stores
from pelsvae.linear_network.solver import Solver
from pelsvae.state_space import Solved, StateSpaceVae

N_STEPS, SHORT = 60, 40
SMALL = VARIANTS["state-space"].replace(max_epochs=120, n_hidden=16, n_latent=4, n_threads=1)


def weather() -> np.ndarray:
    """Return outdoor temperatures of two experiments, one after the other. [degC]."""
    rng = np.random.default_rng(4)
    return 10.0 + 6.0 * np.sin(np.arange(N_STEPS + SHORT) / 4.0) + np.cumsum(rng.normal(0.0, 0.4, 100))


def drive() -> Drive:
    """Return what drives a house of two experiments, the second shorter; its second output is a heat flow."""
    m = N_STEPS + SHORT
    return Drive(
        potentials=weather()[:, None],
        sources=np.zeros((m, 0)),
        pattern=np.zeros(m, dtype=np.int64),
        patterns=np.zeros((1, 0)),
        step=0.5,
        bounds=np.array([0, N_STEPS, m]),
        every=np.array([1, 1]),
        n_before=np.array([0, 0]),
        columns=np.array([[0, 1], [2, 3]]),
        is_alike=np.array([True, False]),
        is_start=np.array([False, False, True]),
        start_ratio=np.array([0.0, 0.0, 1.0]),
        time_powers=np.empty(0),
        source_powers=np.empty(0),
    )


def simulated(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters C, G, start and a store's temperature and heat flow. Shapes (n, 3), (n, t, 4)."""
    rng = np.random.default_rng(seed)
    theta = np.column_stack(
        [np.exp(rng.uniform(0.0, 1.0, n)), np.exp(rng.uniform(-2.0, -1.0, n)), rng.uniform(15.0, 25.0, n)]
    )
    y = np.empty((n, N_STEPS + 1, 4))
    for row, (capacity, conductance, start) in enumerate(theta):
        kept = np.exp(-conductance / capacity)
        for first, last, column in ((0, N_STEPS, 0), (N_STEPS, N_STEPS + SHORT, 2)):
            x, seen = [start], weather()[first:last]
            for outdoor in seen:
                x.append(kept * x[-1] + (1.0 - kept) * outdoor)
            temperature = np.array(x)
            flow = 100.0 * conductance * (temperature - np.concatenate([seen[:1], seen]))
            for place, values in enumerate((temperature, flow)):
                y[row, : len(values), column + place] = values
                y[row, len(values) :, column + place] = values[-1]
    return theta, y


@pytest.fixture(scope="module")
def learnt() -> Surrogate:
    return fit(*simulated(24, 0), simulated(24, 1), config=SMALL, seed=0, drive=drive()).surrogate


def test_exponentials_are_those_of_scipy() -> None:
    rng, step = np.random.default_rng(0), 0.3
    a = 4.0 * rng.normal(size=(3, 3, 5))
    k = int(np.ceil(np.log2(np.abs(a).sum(axis=1).max() * step / kernels.MOST_NORM)))
    series, doubled = np.empty((kernels.N_TERMS, 3, 3, 5)), np.empty((2, k + 1, 3, 3, 5))
    kernels.exponentials(a, step, series, doubled)
    for row in range(5):
        whole = np.zeros((6, 6))
        whole[:3, :3], whole[:3, 3:] = a[:, :, row], np.eye(3)
        exact = expm(whole * step)
        np.testing.assert_allclose(doubled[0, -1, :, :, row], exact[:3, :3], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(doubled[1, -1, :, :, row], exact[:3, 3:], rtol=1e-9, atol=1e-9)


def solver_of(build: Callable[[Drive, int], Form]) -> tuple[Form, Solver]:
    """Return the form of a network with switched inputs and its solver; switches are on at random."""
    its, rng = drive(), np.random.default_rng(8)
    patterns = np.array([[0.0], [1.0]])
    its = replace(its, patterns=patterns, pattern=rng.integers(0, 2, N_STEPS + SHORT))
    inputs, pattern = [its.potentials / 10.0], its.pattern
    if build is modes:
        inputs += [patterns[pattern], np.ones((len(pattern), 1))]
        pattern = np.zeros_like(pattern)
    form = build(its, 2)
    return form, Solver(form, its, np.hstack(inputs), pattern, N_STEPS + 1)


@pytest.mark.parametrize("build", [stores, modes])
def test_slopes_are_those_of_differences(build: Callable[[Drive, int], Form]) -> None:
    (form, solver), rng = solver_of(build), np.random.default_rng(2)
    shapes = (3, form.mean.size), (2, form.n_states, 3)
    elements, first = (torch.tensor(rng.normal(size=shape), requires_grad=True) for shape in shapes)
    weights = torch.tensor(rng.normal(size=(3, 4 * (N_STEPS + 1))), dtype=torch.float32)

    def value() -> torch.Tensor:
        return (Solved.apply(elements, first, solver) * weights).sum()

    value().backward()
    for one in (elements, first):
        assert one.grad is not None
        direction, size = torch.tensor(rng.normal(size=tuple(one.shape))), 1e-3
        along = float((one.grad * direction).sum())
        with torch.no_grad():
            ends = []
            for sign in (1.0, -2.0):
                one += sign * size * direction
                ends.append(float(value()))
            one += size * direction
        # States are in single precision.
        assert (ends[0] - ends[1]) / (2.0 * size) == pytest.approx(along, rel=0.02)


@pytest.mark.parametrize("build", [stores, modes])
def test_outputs_are_those_of_an_integrator(build: Callable[[Drive, int], Form]) -> None:
    (form, solver), rng = solver_of(build), np.random.default_rng(3)
    elements, first = form.mean + 0.5 * rng.normal(size=form.mean.size), rng.normal(size=form.n_states)
    y, _ = solver.solve(elements[:, None], np.tile(first[None, :, None], (2, 1, 1)))
    n_logs, s, c = form.makes.shape[1], form.n_states, solver.inputs.shape[1]
    made = np.concatenate([[1.0], np.exp(form.makes @ elements[:n_logs]), elements[n_logs:]])
    a = (form.to_states @ made).reshape(-1, s, s)
    b = (form.to_inputs @ made).reshape(-1, s, c)
    cd = (form.to_outputs @ made).reshape(-1, s + c)
    at, step, found = first, drive().step, y[:, 0].reshape(N_STEPS + 1, 4)
    for number, (u, pattern) in enumerate(zip(solver.inputs[:N_STEPS], solver.pattern, strict=False)):
        answer = solve_ivp(
            lambda _, x, p=pattern, u=u: a[p] @ x + b[p] @ u, (0.0, step), at, rtol=1e-8, atol=1e-8
        )
        at = answer.y[:, -1]
        outputs = cd @ np.concatenate([at, u])
        expected = outputs if build is modes else [at[0], *outputs]
        np.testing.assert_allclose(found[number + 1, :2], expected, rtol=1e-4, atol=1e-4)


def test_slopes_of_the_prior_are_those_of_its_cost() -> None:
    """Written out here as what autograd differentiates."""
    theta, y = simulated(24, 0)
    its = replace(drive(), time_powers=np.array([1.0, -1.0, 0.0]), source_powers=np.empty(0))
    network = fit(theta, y, None, config=SMALL.replace(max_epochs=1), seed=0, drive=its).surrogate.network
    assert isinstance(network, StateSpaceVae)
    network.requires_grad_(True)
    known = torch.tensor(np.flatnonzero(np.isfinite(network.form.powers)))
    off = network.powers[known] @ torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64)
    cost = 0.5 * (((off - torch.tensor(network.form.powers)[known]) / 0.05) ** 2).sum()
    cost = cost + 0.5 * (((network.constants - torch.tensor(network.form.mean)) / 2.5) ** 2).sum()
    cost = cost + 3.0 * torch.log(network.powers**2 + 0.2**2).sum() + 0.5 * (network.of_code**2).sum()
    cost = cost + 0.5 * ((network.start / 10.0) ** 2).sum() + 0.5 * (network.of_start**2).sum()
    weights = (network.constants, network.powers, network.of_code, network.start, network.of_start)
    slopes = torch.autograd.grad(0.7 * cost, weights)
    for weight in weights:
        weight.grad = torch.zeros_like(weight)
    network.add_slopes_of_prior(0.2, 3.0, 0.7)
    for weight, slope in zip(weights, slopes, strict=True):
        torch.testing.assert_close(weight.grad, slope)


def test_few_rows_teach_it_what_processes_need_many_for(learnt: Surrogate) -> None:
    theta, y = simulated(50, 2)
    processes = fit(*simulated(24, 0), simulated(24, 1), config=VARIANTS["pca-gp"], seed=0).surrogate
    for column in range(4):
        error, of_processes = (
            np.abs(one.predict(theta) - y)[:, :, column].mean() for one in (learnt, processes)
        )
        assert error < 0.5 * of_processes, f"column {column}: {error:.3g} against {of_processes:.3g}"


def test_a_shorter_experiment_keeps_its_last_values(learnt: Surrogate) -> None:
    y = learnt.predict(simulated(3, 5)[0])
    assert (y[:, SHORT:, 2:] == y[:, SHORT : SHORT + 1, 2:]).all()
    assert (np.diff(y[:, SHORT:, 0], axis=1) != 0.0).any()


def test_a_loaded_surrogate_predicts_the_same_bits(learnt: Surrogate, tmp_path: Path) -> None:
    save_surrogate(learnt, tmp_path)
    theta = simulated(70, 3)[0]
    again = load_surrogate(tmp_path).predict(theta, n_jobs=2)
    np.testing.assert_array_equal(again, learnt.predict(theta))


def test_the_same_seed_gives_the_same_surrogate(learnt: Surrogate) -> None:
    theta = simulated(5, 3)[0]
    again = fit(*simulated(24, 0), simulated(24, 1), config=SMALL, seed=0, drive=drive()).surrogate
    np.testing.assert_array_equal(again.predict(theta), learnt.predict(theta))


@pytest.mark.slow
def test_modes_learn_an_oscillator() -> None:
    """Of free oscillations that decay, no network of stores can be one."""
    t = np.arange(N_STEPS + 1)

    def rows(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        theta = np.random.default_rng(seed).uniform([0.3, 0.02], [0.5, 0.05], (n, 2))
        return theta, (np.exp(-theta[:, 1:] * t) * np.cos(theta[:, :1] * t))[:, :, None]

    free = alone(np.zeros((N_STEPS, 0)))
    error = {}
    for states in ("modes", "stores"):
        config = SMALL.replace(states=states, n_stores=2 if states == "modes" else 4)
        surrogate = fit(*rows(30, 0), rows(30, 1), config=config, seed=1, drive=free).surrogate
        theta, y = rows(50, 2)
        error[states] = np.abs(surrogate.predict(theta) - y).mean()
    assert error["modes"] < 0.3 * error["stores"], error


def test_without_inputs_it_is_refused() -> None:
    with pytest.raises(ValueError, match="needs the model's inputs"):
        fit(*simulated(5, 0), simulated(5, 1), config=SMALL, seed=0)
