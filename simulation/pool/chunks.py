"""Which rows of a batch wait, and in what chunks they are handed out."""

import math
from collections import deque

# Towards the end chunks are shorter, so that all processes are busy, but not below this share.
_LEAST = 0.1


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
