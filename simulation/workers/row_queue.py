"""Which rows of an arena wait, and which run owns which.

A row that is given to another at the very moment it begins is simulated by both, who write the same answer.
"""

import math
from collections import deque
from typing import Final

import numpy as np

from simulation.workers.arena import Arena, RowState
from simulation.workers.messages import Run

_MAX_OVERRUN: Final = 4.0


class RowQueue:
    """The rows of an arena that nobody has begun, handed out in runs of consecutive ones.

    Attributes:
        n_waiting: Rows that are in nobody's hands.
    """

    def __init__(self, arena: Arena, number: int = 0, *, run_s: float, min_run_s: float) -> None:
        """Let all rows of an arena wait.

        Args:
            arena: The arena.
            number: A number that no other load of an arena has.
            run_s: Longest time that a run should take. [s]
            min_run_s: Shortest time for which a run is worth handing out. [s]
        """
        self._arena = arena
        self._number = number
        self._run_s = run_s
        self._min_run_s = min_run_s
        self._waiting: deque[tuple[int, int]] = deque([(0, arena.n)] if arena.n else [])
        self._n_runs = 0
        self.n_waiting = arena.n

    def take(self, row_s: float | None, n_workers: int, max_rows: int = 2**31) -> Run:
        """Hand out the next rows: one where nothing is known of their time, else as much as is worth a run.

        Args:
            row_s: Expected time per row; None before the first. [s]
            n_workers: Among how many the rows are shared.
            max_rows: Most rows to hand out, at least one.
        """
        start, end = self._waiting.popleft()
        length = 1 if row_s is None else self._length(max(row_s, 1e-7), n_workers)
        stop = min(end, start + max(1, min(length, max_rows)))
        if stop < end:
            self._waiting.appendleft((stop, end))
        self.n_waiting -= stop - start
        self._n_runs += 1
        self._arena.owners[start:stop] = self._n_runs
        budget_s = _MAX_OVERRUN * max(self._run_s, (stop - start) * (row_s or 0.0))
        return Run(self._n_runs, self._arena.address, self._number, start, stop, budget_s)

    def _length(self, row_s: float, n_workers: int) -> int:
        fair = math.ceil(self.n_waiting / (2 * max(1, n_workers)))
        return max(1, min(int(self._run_s / row_s), max(fair, int(self._min_run_s / row_s))))

    def rows(self, run: Run, state: RowState) -> list[int]:
        """Return the rows in some state that a run still owns."""
        part = slice(run.start, run.stop)
        owned = (self._arena.states[part] == state) & (self._arena.owners[part] == run.number)
        return [run.start + i for i in np.flatnonzero(owned).tolist()]

    def give_back(self, run: Run) -> None:
        """Let others have the rows of a run that nobody has begun."""
        rows = self.rows(run, RowState.WAITING)
        self._arena.owners[rows] = 0
        for row in reversed(rows):
            if self._waiting and self._waiting[0][0] == row + 1:
                self._waiting[0] = (row, self._waiting[0][1])
            else:
                self._waiting.appendleft((row, row + 1))
        self.n_waiting += len(rows)
