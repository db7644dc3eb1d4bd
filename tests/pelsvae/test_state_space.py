"""A decoder that knows the inputs: its mathematics against SciPy, and what it learns from few rows."""

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
from pelsvae.state_space import Walked

N_STEPS, SHORT = 60, 40
PLACES = [np.arange(N_STEPS + SHORT)]  # steps of the one pattern
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


def test_slopes_are_those_of_differences() -> None:
    its, rng = drive(), np.random.default_rng(2)
    a = torch.tensor(0.3 * rng.normal(size=(1, 2, 2, 3)) - np.eye(2)[None, :, :, None], requires_grad=True)
    b = torch.tensor(rng.normal(size=(1, 2, 1, 3)), requires_grad=True)
    first = torch.tensor(rng.normal(size=(2, 2, 3)), requires_grad=True)
    inputs = np.ascontiguousarray(its.potentials / 10.0, dtype=np.float32)
    weights = torch.tensor(rng.normal(size=(N_STEPS + SHORT + 2, 2, 3)), dtype=torch.float32)

    def value() -> torch.Tensor:
        return (Walked.apply(a, b, first, inputs, its.pattern, PLACES, its) * weights).sum()

    value().backward()
    for one in (a, b, first):
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


def test_states_are_those_of_an_integrator() -> None:
    its = drive()
    a, b = np.array([[-0.5, 0.2], [0.1, -0.3]]), np.array([[0.3], [0.2]])
    first = np.array([2.0, -1.0])
    x = Walked.apply(
        torch.tensor(a[None, :, :, None]),
        torch.tensor(b[None, :, :, None]),
        torch.tensor(np.tile(first[None, :, None], (2, 1, 1))),
        np.ascontiguousarray(its.potentials, dtype=np.float32),
        its.pattern,
        PLACES,
        its,
    )
    at = first
    for step, outdoor in enumerate(weather()[:N_STEPS]):
        answer = solve_ivp(
            lambda _, x, u=outdoor: a @ x + b[:, 0] * u, (0.0, its.step), at, rtol=1e-8, atol=1e-8
        )
        at = answer.y[:, -1]
        np.testing.assert_allclose(x[step + 1, :, 0], at, rtol=1e-4, atol=1e-4)


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
