"""Closed-form cases for the surrogate: the step response of a resistance and a capacity, and waves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pelsvae.config import SurrogateConfig
from pelsvae.linear_network.drive import Drive

TIME_S = np.linspace(0.0, 40.0, 21)
SMALL = SurrogateConfig(
    n_latent=4,
    n_hidden=16,
    n_layers=3,
    activation="silu",
    theta_features="linear+log",
    n_prediction_samples=6,
    learning_rate=1e-2,
    max_epochs=60,
    patience=60,
    validate_every=5,
    device="cpu",
    n_threads=1,
)
RESIDUAL = SMALL.replace(residual=True, n_layers=4)

PROCESSES = SurrogateConfig(
    regressor="gaussian-process", theta_features="linear+log", max_epochs=15, device="cpu", n_threads=1
)


def rc_step(n: int, seed: int, n_outputs: int = 1) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return theta (n, 2) = (R, C) and y (n, 21, k): temperature, then heat flow in another unit."""
    theta = np.random.default_rng(seed).uniform([1.0, 2.0], [3.0, 8.0], size=(n, 2))
    decay = np.exp(-TIME_S / theta.prod(axis=1, keepdims=True))
    temperature = 20.0 + 5.0 * (1.0 - decay)
    flow = 1e4 * 5.0 * decay / theta[:, :1]
    return theta, np.stack([temperature, flow], axis=2)[:, :, :n_outputs]


def alone(potentials: npt.NDArray[np.float64]) -> Drive:
    """Return what drives one experiment of one output and two parameters: potentials (m, a), and no more."""
    m = len(potentials)
    return Drive(
        potentials=potentials,
        sources=np.zeros((m, 0)),
        pattern=np.zeros(m, dtype=np.int64),
        patterns=np.zeros((1, 0)),
        step=0.5,
        bounds=np.array([0, m]),
        every=np.array([1]),
        n_before=np.array([0]),
        columns=np.array([[0]]),
        is_alike=np.array([True]),
        is_start=np.zeros(2, dtype=np.bool_),
        start_ratio=np.zeros(2),
        time_powers=np.empty(0),
        source_powers=np.empty(0),
    )


def step_drive() -> Drive:
    """Return what drives the temperature of `rc_step`: 25 degC from the start on."""
    return alone(np.full((len(TIME_S) - 1, 1), 25.0))
