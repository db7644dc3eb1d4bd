"""Objectives as users write them."""

import time

import numpy as np
import optuna

from studies.tuning.live_trial import LiveTrial


def bowl(trial: LiveTrial) -> float:
    """Fall along a noisy curve; where it stands high it is pruned."""
    x, kind = trial.suggest_float("x", -2.0, 2.0), trial.suggest_categorical("kind", ["round", "flat"])
    rng, value = np.random.default_rng(trial.seed), 0.0
    for step in range(4):
        value = (x - 0.3) ** 2 + 1.0 / (step + 1) + 1e-3 * rng.normal() + 1e-6 * np.random.normal()  # noqa: NPY002
        trial.log({"loss": value, "bad name?": x}, step=step)
        trial.report(value, step)
        if trial.should_prune():
            raise optuna.TrialPruned
    return float(value) + (0.1 if kind == "flat" else 0.0)


def pair(trial: LiveTrial) -> tuple[float, float]:
    """Return two values that are at odds, one of them to be maximized, under a constraint."""
    x = trial.suggest_float("x", 0.0, 2.0)
    trial.set_constraint("x - 1.5", x - 1.5)
    time.sleep(0.3)
    return x**2, x


def picky(trial: LiveTrial) -> object:
    """Return what it should not, or raise."""
    if trial.number == 4:
        return 1.0 / trial.suggest_int("zero", 0, 0)
    return [float("nan"), "no", np.array([1.0, 2.0]), None][trial.number]


def wrong(trial: LiveTrial) -> float:
    """Fail always."""
    raise ValueError(f"no data\nof {trial.number}")
