"""Rows that a search collects, and their coordinates in a basis that grows with them.

n rows span n directions at most, however many residuals a row has: from a row's coordinates on, work does not
grow with the number of residuals, and a row is reduced to them once.
"""

import numpy as np

from simulation.arrays import FloatArray

# Part of a row beside the basis that is rounding.
# A row's own rounding is 1e-16 of it, and sums of many residuals round a few times that.
ROUNDING = 1e-14


class GrowingRows:
    """Rows of equal width; adding one copies the others now and then, not each time."""

    def __init__(self, width: int) -> None:
        """Begin without rows."""
        self._held, self._n = np.empty((0, width)), 0

    @property
    def rows(self) -> FloatArray:
        """All rows. Shape (n, width)."""
        return self._held[: self._n]

    def add(self, rows: FloatArray) -> None:
        """Add rows (k, width)."""
        n, n_held = self._n + len(rows), len(self._held)
        if n > n_held:
            held = np.empty((max(n, n_held + n_held // 2), self._held.shape[1]))
            held[: self._n] = self.rows
            self._held = held
        self._held[self._n : n] = rows
        self._n = n


class GrowingBasis:
    """An orthonormal basis of rows, and the rows' coordinates in it: they keep all products of rows."""

    def __init__(self, width: int) -> None:
        """Begin without rows."""
        self._axes = GrowingRows(width)
        self._coordinates = list[FloatArray]()

    @property
    def n_rows(self) -> int:
        """Rows that are known."""
        return len(self._coordinates)

    def add(self, rows: FloatArray) -> None:
        """Add rows (k, width); those that are not finite have no coordinates."""
        for row in rows:
            if not np.isfinite(row).all():
                self._coordinates.append(np.array([np.nan]))
                continue
            axes, rest = self._axes.rows, row
            along = np.zeros(len(axes))
            # Twice is enough for all digits.
            # (Gram-Schmidt, repeated once: Giraud and others 2005, doi:10.1007/s00211-005-0615-4.)
            for _ in range(2):
                step = axes @ rest
                rest, along = rest - step @ axes, along + step
            size = float(np.sqrt(rest @ rest))
            if size > ROUNDING * float(np.sqrt(row @ row)):
                self._axes.add(rest[None] / size)
                along = np.append(along, size)
            self._coordinates.append(along)

    @property
    def coordinates(self) -> FloatArray:
        """Coordinates of all rows, NaN of those that are not finite. Shape (n, r). [unit]."""
        found = np.zeros((self.n_rows, len(self._axes.rows)))
        for row, along in enumerate(self._coordinates):
            if np.isnan(along).any():
                found[row] = np.nan
            else:
                found[row, : along.size] = along
        return found
