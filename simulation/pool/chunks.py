"""Which rows of a batch wait, in what chunks they are handed out, and when too many have failed."""

import math
import re
from collections import Counter, deque
from collections.abc import Sequence
from typing import Final

from simulation.pool.execution import ExecutionPolicy, TooManyFailuresError

_NUMBER: Final = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
# Towards the end chunks are shorter, so that all processes are busy, but not below this share.
_LEAST: Final = 0.1


class RowQueue:
    """The rows of a batch that no process has, handed out in chunks of consecutive ones.

    Attributes:
        n_waiting: How many.
    """

    def __init__(self, n: int, *, chunk_s: float, max_rows: int) -> None:
        """Put all rows into the queue.

        Args:
            n: Rows.
            chunk_s: How long a chunk should take. [s]
            max_rows: Most rows of a chunk.
        """
        self._chunk_s = chunk_s
        self._max_rows = max_rows
        self._waiting: deque[range] = deque()
        self.n_waiting = 0
        self.put(range(n))

    def take(self, row_s: float | None, n_processes: int) -> range:
        """Hand out the next rows: one where nothing is known of their time.

        Args:
            row_s: Expected time per row. [s]
            n_processes: Among how many the rows are shared.
        """
        rows, n = self._waiting.popleft(), 1
        self.n_waiting -= len(rows)
        if row_s is not None:
            usual = self._chunk_s / max(row_s, 1e-7)
            fair = math.ceil((self.n_waiting + len(rows)) / (2 * n_processes))
            n = max(1, min(int(usual), max(fair, int(_LEAST * usual)), self._max_rows))
        self.put(rows[n:])
        return rows[:n]

    def put(self, rows: range) -> None:
        """Put rows back, before all others.

        Args:
            rows: The rows, which will not be in one chunk with others.
        """
        if rows:
            self._waiting.appendleft(rows)
            self.n_waiting += len(rows)


class FailureCount:
    """Finished and failed rows of a batch."""

    def __init__(self, policy: ExecutionPolicy) -> None:
        """Begin with no rows.

        Args:
            policy: How many may fail.
        """
        self._policy = policy
        self._kinds: Counter[str] = Counter()
        self._examples: dict[str, str] = {}
        self._n = 0

    def add(self, failures: Sequence[str]) -> None:
        """Count rows that have finished.

        Args:
            failures: Why they failed; "" for those that are good.

        Raises:
            TooManyFailuresError: If too many have failed by now.
        """
        for reason in filter(None, failures):
            kind = _NUMBER.sub("#", reason)
            self._kinds[kind] += 1
            self._examples.setdefault(kind, reason)
        self._n += len(failures)
        n, n_failed, share = self._n, self._kinds.total(), self._policy.max_failed_share
        if not self._policy.is_hopeless(n, n_failed):
            return
        ((kind, n_times),) = self._kinds.most_common(1)
        raise TooManyFailuresError(
            f"{n_failed} of {n} simulations failed, more than simulation.max_failed_share = {share:g} "
            f"allows; the commonest reason ({n_times} of them): {self._examples[kind]}; narrow the bounds, "
            "mend the model, widen what the case accepts or raise the share"
        )
