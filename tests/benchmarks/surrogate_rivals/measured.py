"""One training and what it came to: errors on the test set, times, coverage of the 90 % band."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pelsvae.metrics import errors
from simulation import uniform_design
from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Z_90, Clock, Fitted
from surrogate_rivals.problems import Data, Sets

N_PREDICTIONS = 10_000
PREDICTION_SEED = 777

Train = Callable[[Data, int], Fitted]
"""Data and seed to a trained surrogate."""


@dataclass(frozen=True)
class Run:
    """One training. Times are CPU seconds of one thread.

    Attributes:
        n: Training rows that were good.
        mae: Mean absolute error on the test set. [first output's unit]
        p90: 90th percentile over rows of the row's mean. [first output's unit]
        train_s: Training with all its choices. [s]
        fit_s: The last fit alone. [s]
        predict_s: 10,000 predictions. [s]
        coverage: Part of the test set's values within the 90 % band; None where none is stated.
        settings: What was chosen.
    """

    n: int
    mae: float
    p90: float
    train_s: float
    fit_s: float
    predict_s: float
    coverage: float | None
    settings: str


def run_once(train: Train, sets: Sets, n: int, seed: int) -> Run:
    """Train on the first n rows and judge.

    Args:
        train: The method.
        sets: Data; at least n training rows.
        n: Rows that it may see.
        seed: Of everything that the method draws.
    """
    data = sets.learnt.first(n)
    clock = Clock()
    fitted = train(data, seed)
    train_s = clock.s
    theta, y = sets.test
    found = errors(fitted.predict(theta), y, data.output_scales)
    many = uniform_design(data.space, N_PREDICTIONS, PREDICTION_SEED)
    clock = Clock()
    fitted.predict(many)
    predict_s = clock.s
    return Run(
        n=len(data.theta),
        mae=found.mae,
        p90=found.p90,
        train_s=round(train_s, 3),
        fit_s=round(fitted.fit_s, 3),
        predict_s=round(predict_s, 4),
        coverage=None if fitted.deviation is None else _coverage(fitted, theta, y),
        settings=fitted.settings,
    )


def _coverage(fitted: Fitted, theta: FloatArray, y: FloatArray) -> float:
    assert fitted.deviation is not None
    inside = np.abs(fitted.predict(theta) - y) <= Z_90 * fitted.deviation(theta)
    return float(inside.mean())
