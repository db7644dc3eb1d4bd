"""How far a tuning is, on one bar per training-set size: trials, running epochs, the best so far."""

from collections.abc import Sequence

from studies.console import OnBar
from studies.report.wording import quantity
from studies.tuning.study_spec import TuneEvent


class TuningProgress:
    """Turns what the workers tell into bars.

    Args:
        bars: shows them.
        sizes: training-set sizes.
        n_trials: trials per size.
        unit: unit of the errors.
    """

    def __init__(self, bars: OnBar, sizes: Sequence[int], n_trials: int, unit: str) -> None:
        self._bars = bars
        self._unit = unit
        self._n_trials = n_trials
        self._n_finished = dict.fromkeys(sizes, 0)
        self._running: dict[tuple[int, int], float] = {}

    def hear(self, event: TuneEvent) -> None:
        """Hear of a trial or an epoch."""
        n_train, trial = event.n_train, (event.n_train, event.index)
        if event.kind in ("trial-started", "epoch"):
            self._running[trial] = event.epoch / event.max_epochs if event.max_epochs else 0.0
        elif event.kind == "trial-finished":
            self._running.pop(trial, None)
        else:
            self._running = {key: part for key, part in self._running.items() if key[0] != n_train}
        self._n_finished[n_train] = event.n_finished
        if len(self._n_finished) > 1:
            done = sum(self._done(size) for size in self._n_finished)
            self._bars("all sizes", done, self._n_trials * len(self._n_finished))
        self._bars(f"n_train {n_train}", self._done(n_train), event.n_trials, self._news(event))

    def _done(self, n_train: int) -> float:
        parts = sum(part for (size, _), part in self._running.items() if size == n_train)
        return min(self._n_finished[n_train] + parts, self._n_trials)

    def _news(self, event: TuneEvent) -> str:
        return "" if event.best is None else f": best MAE {quantity(event.best, self._unit)}"
