"""Where the row of given parameters lies: sorted arrays, no object per row."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from simulation.arrays import BoolArray, FloatArray, IntArray

Keys = npt.NDArray[np.void]
"""Rows of parameters as opaque bytes: what compares, compares exactly."""


def row_keys(theta: FloatArray) -> Keys:
    """Return each row's exact bytes. Shape (n,)."""
    rows = np.ascontiguousarray(theta, dtype="<f8")
    return rows.view(np.dtype((np.void, 8 * rows.shape[1]))).reshape(len(rows))


@dataclass(frozen=True, eq=False)
class Entries:
    """Rows of parts, in any order.

    Attributes:
        keys: Their parameters. Shape (n,).
        part: Number of the part. Shape (n,).
        row: Number of the row in it. Shape (n,).
        good: Whether the simulation succeeded. Shape (n,).
        written: When the row was written. Shape (n,). [µs]
    """

    keys: Keys
    part: npt.NDArray[np.int32]
    row: npt.NDArray[np.int32]
    good: BoolArray
    written: IntArray

    @classmethod
    def of_part(cls, part: int, theta: FloatArray, good: BoolArray, written: IntArray) -> "Entries":
        """Return all rows of a part. Shapes (n, p), (n,), (n,)."""
        n = len(theta)
        return cls(
            row_keys(theta), np.full(n, part, dtype=np.int32), np.arange(n, dtype=np.int32), good, written
        )

    @classmethod
    def joined(cls, several: Sequence["Entries"]) -> "Entries":
        """Return the entries of all."""
        return cls(
            np.concatenate([one.keys for one in several]),
            np.concatenate([one.part for one in several]),
            np.concatenate([one.row for one in several]),
            np.concatenate([one.good for one in several]),
            np.concatenate([one.written for one in several]),
        )

    def take(self, which: npt.NDArray[np.intp] | BoolArray) -> "Entries":
        """Return some of the entries."""
        return Entries(
            self.keys[which], self.part[which], self.row[which], self.good[which], self.written[which]
        )

    def best(self) -> "Entries":
        """Return one entry per key, sorted by key: a good row before a failed one, then the newest."""
        order = np.lexsort((self.written, self.good))
        order = order[np.argsort(self.keys[order], kind="stable")]
        keys = self.keys[order]
        is_last = np.ones(len(keys), dtype=np.bool_)
        is_last[:-1] = keys[1:] != keys[:-1]
        return self.take(order[is_last])


class RowIndex:
    """The rows of a store by their parameters.

    Entries lie in sorted segments, each at least twice as long as the next, so that adding one row to a
    million costs no sorting of a million.
    """

    def __init__(self, n_parameters: int) -> None:
        """Start without rows.

        Args:
            n_parameters: Columns of theta.
        """
        self._n_parameters = n_parameters
        self._segments: list[Entries] = []

    def add(self, several: Sequence[Entries]) -> None:
        """Add rows; where parameters are known already, the better row counts.

        Args:
            several: The rows of several parts.
        """
        several = [one for one in several if len(one.keys)]
        if not several:
            return
        new = Entries.joined(several).best()
        while self._segments and len(self._segments[-1].keys) < 2 * len(new.keys):
            new = Entries.joined([self._segments.pop(), new]).best()
        self._segments.append(new)

    def drop(self, parts: Collection[int]) -> None:
        """Forget the rows of parts that are not there any more.

        Args:
            parts: Numbers of the parts.
        """
        gone = np.array(sorted(parts), dtype=np.int32)
        kept = [one.take(~np.isin(one.part, gone)) for one in self._segments]
        self._segments = [one for one in kept if len(one.keys)]

    def look_up(self, theta: FloatArray) -> tuple[BoolArray, Entries]:
        """Find rows.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Which are known, shape (n,), and an entry for each; what the entry of an unknown one says means
            nothing.
        """
        keys = row_keys(theta)
        n = len(keys)
        known = np.zeros(n, dtype=np.bool_)
        found = Entries(
            keys,
            np.full(n, -1, dtype=np.int32),
            np.zeros(n, dtype=np.int32),
            np.zeros(n, dtype=np.bool_),
            np.zeros(n, dtype=np.int64),
        )
        for segment in self._segments:
            at = np.minimum(np.searchsorted(segment.keys, keys), len(segment.keys) - 1)
            better = segment.keys[at] == keys
            newer = segment.written[at] >= found.written
            same_kind = segment.good[at] == found.good
            better &= ~known | (segment.good[at] & ~found.good) | (same_kind & newer)
            found.part[better], found.row[better] = segment.part[at[better]], segment.row[at[better]]
            found.good[better], found.written[better] = segment.good[at[better]], segment.written[at[better]]
            known |= better
        return known, found

    def all(self) -> Entries:
        """Return one entry per known row, in the order in which they lie in the parts."""
        if not self._segments:
            return self.look_up(np.empty((0, self._n_parameters)))[1]
        found = Entries.joined(self._segments).best()
        return found.take(np.lexsort((found.row, found.part)))
