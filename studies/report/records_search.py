"""What the pictures of one search draw: its trials in the order they were tried, and what they taught.

Shapes use m trials, p hyperparameters, e epochs validated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studies.report.records import Booleans, Floats, Integers, require_shape
from studies.report.records_tuning import TRIAL_STATES


@dataclass(frozen=True, eq=False)
class TrialCurve:
    """How one training went.

    Attributes:
        epoch: Epochs that were validated. Shape (e,).
        validation_mae: Shape (e,). [output unit, differences]
        state: How the trial ended.
        is_best: Whether it is the best of its study.
    """

    epoch: Integers
    validation_mae: Floats
    state: str
    is_best: bool


@dataclass(frozen=True)
class SearchRecord:
    """Every trial of one study.

    Attributes:
        n_train: Size of the training set.
        names: Hyperparameters, p entries.
        is_log: Which of them are searched on a logarithmic scale. Shape (p,).
        values: Hyperparameters per trial; NaN where a trial has none. Shape (m, p).
        error: Validation error; for a pruned trial the last one, NaN for a failed one. Shape (m,).
            [output unit, differences]
        state: How each trial ended, m entries.
        is_best: True for the best one, at most once. Shape (m,).
        importance: Share of the error's variation that each hyperparameter explains; NaN where too few
            trials tell. Shape (p,). [1]
        curves: Learning curves of the trials that have one.
    """

    n_train: int
    names: tuple[str, ...]
    is_log: Booleans
    values: Floats
    error: Floats
    state: tuple[str, ...]
    is_best: Booleans
    importance: Floats
    curves: tuple[TrialCurve, ...] = ()

    def __post_init__(self) -> None:
        m, p = len(self.state), len(self.names)
        require_shape("the search's hyperparameters", self.values, (m, p))
        for what, values, shape in (
            ("is_log", self.is_log, (p,)),
            ("error", self.error, (m,)),
            ("is_best", self.is_best, (m,)),
            ("importance", self.importance, (p,)),
        ):
            require_shape(f"the search's {what}", values, shape)
        unknown = sorted(set(self.state) - set(TRIAL_STATES))
        if unknown:
            raise ValueError(f"unknown trial state {unknown[0]!r}, expected one of {', '.join(TRIAL_STATES)}")

    @property
    def judged(self) -> Integers:
        """Positions of the trials with an error, the worst first, so that the best are drawn on top."""
        usable = np.flatnonzero(np.isfinite(self.error) & (self.error > 0))
        return usable[np.argsort(-self.error[usable], kind="stable")].astype(np.int64)
