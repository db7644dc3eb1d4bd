"""Which parts a store has at the moment, and where each row lies in them."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import chain
from typing import Final

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.store.folder import StoreFolder, groups_to_merge
from simulation.store.index import Entries, RowIndex, row_keys
from simulation.store.parts import Part, PartDamagedError, write_part
from simulation.store.rows import Layout, Rows
from simulation.trajectories import Trajectories

_MAX_OPEN: Final = 32
_END_OF_TIME: Final = 2**62

_log = logging.getLogger(__name__)


class Catalog:
    """The parts of a folder that other processes add to, merge and set aside at any moment."""

    def __init__(self, files: StoreFolder, layout: Layout, on_warning: Callable[[str], None]) -> None:
        """Read what identifies the rows that there are.

        Args:
            files: The folder.
            layout: What its rows have in common.
            on_warning: Told in one line of a part that was set aside.
        """
        self._files, self._layout, self._warn = files, layout, on_warning
        # Parts are numbered as they are met, so that an index need not hold names.
        self._numbers: dict[str, int] = {}
        self._n_numbered = 0
        self._latest = 0
        self._sizes: dict[str, int] = {}
        self._open: dict[str, Part] = {}
        self._index = RowIndex(len(layout.parameter_names))
        self.refresh()

    def refresh(self) -> None:
        """Take note of parts that have come and gone."""
        self._sizes = self._files.sizes()
        self._forget([name for name in self._numbers if name not in self._sizes])
        names = [name for name in self._sizes if name not in self._numbers]
        found = [self._entries(name) for name in names]
        self._index.add([entries for entries in found if entries is not None])
        if any(entries is None for entries in found):
            # What could be saved of a damaged part lies in a new one.
            self.refresh()

    def now(self) -> int:
        """Return the time, later than that of all rows even where a clock was put back. [µs since 1970]."""
        return max(time.time_ns() // 1000, min(self._latest + 1, _END_OF_TIME))

    def look_up(self, theta: FloatArray) -> tuple[BoolArray, Entries]:
        """Find rows as of the last refresh: which are known, shape (n,), and where they lie.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
        """
        return self._index.look_up(theta)

    def theta(self) -> FloatArray:
        """Return the parameters of all rows, in the order in which they lie. Shape (n, p)."""
        keys = self._index.all().keys
        return np.frombuffer(keys.tobytes(), dtype="<f8").reshape(
            len(keys), len(self._layout.parameter_names)
        )

    def read(self, theta: FloatArray, found: Entries) -> Trajectories | None:
        """Read rows from where they lie.

        Args:
            theta: Their parameters. Shape (n, p). [per parameter]
            found: Where they lie.

        Returns:
            The rows; None where a part has vanished, or was damaged and is set aside now.
        """
        names = {number: name for name, number in self._numbers.items()}
        y = np.empty((len(theta), len(self._layout.time), len(self._layout.output_names)))
        failures = [""] * len(theta)
        for number in np.unique(found.part):
            rows, name = np.flatnonzero(found.part == number), names[int(number)]
            try:
                answer = self._part(name).read(found.row[rows]).trajectories
                if not np.array_equal(row_keys(answer.theta), found.keys[rows]):
                    raise PartDamagedError(f"{self._files.path / name}: parameters have changed")
            except FileNotFoundError:
                return None
            except PartDamagedError as damage:
                self._set_aside(name, damage, self._open.pop(name, None))
                return None
            y[rows] = answer.y
            for row, reason in zip(rows, answer.failures, strict=True):
                failures[row] = reason
        return self._layout.trajectories(theta, y, failures)

    def add(self, rows: Rows, *, synced: bool) -> None:
        """Write a new part.

        Args:
            rows: Its rows.
            synced: Whether it must be safe against a crash of the machine when this returns.

        Raises:
            OSError: If it cannot be written; nothing of it is stored then.
        """
        name = self._files.publish(lambda file: write_part(file, self._layout, [rows]), synced=synced)
        found = rows.trajectories
        self._index.add([self._numbered(name, found.theta, ~found.failed, rows.written)])
        self.refresh()

    def merge_small(self) -> None:
        """Merge parts where there are many of a size, unless another process does."""
        lock = self._files.merging()
        if not groups_to_merge(self._sizes) or not lock.try_acquire():
            return
        try:
            self.refresh()
            for names in groups_to_merge(self._sizes):
                if all(name in self._numbers for name in names):
                    self._merge(names)
        except OSError as error:
            # All rows lie in the parts as before.
            _log.info("parts of %s are not merged: %s", self._files.path, error)
        finally:
            lock.release()

    def close(self) -> None:
        """Let go of all files; the next reading opens them again."""
        while self._open:
            self._open.popitem()[1].close()

    def _entries(self, name: str) -> Entries | None:
        """Read what identifies a new part's rows; None where it is gone, or damaged and set aside."""
        part = None
        try:
            part = Part(self._files.path / name, self._layout)
            theta, good, written = part.keys()
        except FileNotFoundError:
            return None
        except PartDamagedError as damage:
            self._set_aside(name, damage, part)
            return None
        part.close()
        return self._numbered(name, theta, good, written)

    def _numbered(self, name: str, theta: FloatArray, good: BoolArray, written: IntArray) -> Entries:
        number = self._numbers[name] = self._n_numbered
        self._n_numbered += 1
        self._latest = max(self._latest, int(written.max(initial=0)))
        return Entries.of_part(number, theta, good, written)

    def _forget(self, names: list[str]) -> None:
        if names:
            self._index.drop([self._numbers.pop(name) for name in names])
        for name in names:
            if name in self._open:
                self._open.pop(name).close()

    def _part(self, name: str) -> Part:
        part = self._open.pop(name, None) or Part(self._files.path / name, self._layout)
        # The one used last stands last: the first is the one to close.
        self._open[name] = part
        if len(self._open) > _MAX_OPEN:
            self._open.pop(next(iter(self._open))).close()
        return part

    def _set_aside(self, name: str, damage: PartDamagedError, part: Part | None) -> None:
        """Move a damaged part away, after its good rows have been copied to a new one."""
        saved = part.salvage() if part is not None else iter(())
        first = next(saved, None)
        if first is not None:
            whole = chain([first], saved)
            self._files.publish(lambda file: write_part(file, self._layout, whole))
        if part is not None:
            part.close()
        place = self._files.set_aside(name)
        self._forget([name] if name in self._numbers else [])
        rest = "its undamaged rows are kept, the others" if first is not None else "its rows"
        self._warn(f"{damage}; moved to {place.parent.name}/, {rest} are simulated again when needed")

    def _merge(self, names: list[str]) -> None:
        with suppress(PartDamagedError):
            merged = self._files.publish(lambda file: write_part(file, self._layout, self._best_rows(names)))
            self.refresh()
            if merged in self._numbers:
                self._files.remove(names)
        self.refresh()

    def _best_rows(self, names: list[str]) -> Iterator[Rows]:
        """Read the rows of parts without those that better ones have replaced."""
        for name in names:
            part, start = Part(self._files.path / name, self._layout), 0
            try:
                for rows in part.blocks():
                    _, found = self._index.look_up(rows.trajectories.theta)
                    best = (found.row == start + np.arange(rows.n)) & (found.part == self._numbers[name])
                    if best.any():
                        yield rows.take(best)
                    start += rows.n
            except PartDamagedError as damage:
                self._set_aside(name, damage, part)
                raise
            finally:
                part.close()
