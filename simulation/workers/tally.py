"""How far a campaign is, how fast, and whether there is any point in going on."""

import math
import re
from collections import Counter
from collections.abc import Callable
from typing import Final

import numpy as np

from simulation.workers.arena import Arena, RowState
from simulation.workers.execution import CampaignStopped

# Below this many finished rows a share of failed ones says nothing.
_MIN_ROWS: Final = 20
_DEVIATIONS: Final = 2.0
_NUMBER: Final = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")


class Tally:
    """Finished and failed rows of a campaign, over all its arenas.

    Attributes:
        n_finished: Rows finished in earlier arenas.
        n_failed: Those of them that failed.
        has_warned: Whether a slow row was reported.
    """

    def __init__(self, max_failed_share: float, on_progress: Callable[[int], None] | None = None) -> None:
        """Begin at nothing.

        Args:
            max_failed_share: See ExecutionPolicy.
            on_progress: Told how many rows have finished, whenever that changes.
        """
        self._max_failed_share = max_failed_share
        self._on_progress = on_progress
        self._reported = -1
        self._reasons: Counter[str] = Counter()
        self.n_finished = 0
        self.n_failed = 0
        self.has_warned = False

    def look_at(self, arena: Arena) -> bool:
        """Count the rows of the arena at work.

        Args:
            arena: The arena.

        Returns:
            Whether all its rows are finished.

        Raises:
            CampaignStopped: If too many rows failed.
        """
        states = arena.states[: arena.n]
        n_failed = int(np.count_nonzero(states == RowState.FAILED))
        n_done = n_failed + int(np.count_nonzero(states == RowState.GOOD))
        if self.n_finished + n_done != self._reported:
            self._reported = self.n_finished + n_done
            if self._on_progress is not None:
                self._on_progress(self._reported)
            self._stop_if_hopeless(arena, self.n_failed + n_failed)
        return n_done == arena.n

    def close(self, arena: Arena) -> None:
        """Add an arena whose rows are all finished to the earlier ones."""
        reasons = self._reasons_in(arena)
        self._reasons += reasons
        self.n_failed += reasons.total()
        self.n_finished += arena.n

    def _reasons_in(self, arena: Arena) -> Counter[str]:
        failed = np.flatnonzero(arena.states[: arena.n] == RowState.FAILED)
        return Counter(arena.reason(row) for row in failed.tolist())

    def _stop_if_hopeless(self, arena: Arena, n_failed: int) -> None:
        n, share = self._reported, self._max_failed_share
        # Bad luck among the first is no reason.
        if n < _MIN_ROWS or n_failed <= share * n + _DEVIATIONS * math.sqrt(share * (1.0 - share) * n):
            return
        commonest, n_times = _commonest(self._reasons + self._reasons_in(arena))
        raise CampaignStopped(
            f"{n_failed} of {n} simulations failed, more than simulation.max_failed_share = {share:g} "
            f"allows; the commonest reason ({n_times} of them): {commonest}; narrow the bounds, mend the "
            "model, widen what the case accepts or raise the share"
        )


def _commonest(reasons: Counter[str]) -> tuple[str, int]:
    """Return an example of the commonest reason, and how often it came with whatever numbers."""
    kinds: Counter[str] = Counter()
    for reason, n_times in reasons.items():
        kinds[_NUMBER.sub("#", reason)] += n_times
    kind, n_times = kinds.most_common(1)[0]
    return next(reason for reason in reasons if _NUMBER.sub("#", reason) == kind), n_times


class Speed:
    """How long a row of a model takes, from one campaign to the next.

    Attributes:
        row_s: Recent time per row; None before it is known. [s]
        slowest_s: Longest time that a row has taken, with those it was handed out with. [s]
    """

    def __init__(self) -> None:
        self.row_s: float | None = None
        self.slowest_s: float | None = None
        self._is_warm = False

    def saw(self, n_rows: int, spent_s: float) -> None:
        """Learn from a run; the first may have compiled or loaded something and says nothing."""
        self.slowest_s = max(self.slowest_s or 0.0, spent_s)
        if self._is_warm:
            row_s = spent_s / n_rows
            self.row_s = row_s if self.row_s is None else min(row_s, 0.5 * (self.row_s + row_s))
        self._is_warm = True
