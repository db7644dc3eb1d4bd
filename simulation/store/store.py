"""Every simulated row of one model, kept once: a folder of Parquet parts that many processes may share."""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Final

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.store.catalog import Catalog
from simulation.store.folder import StoreFolder, read_layout
from simulation.store.rows import Layout, Rows
from simulation.trajectories import Trajectories

BLOCK_BYTES: Final = 64 * 2**20
"""Outputs that a stream holds at once."""
# Reading begins again when parts are merged under it; nobody merges as often as this in a row.
_PATIENCE: Final = 20
_CHEAP_S: Final = 1.0

_log = logging.getLogger(__name__)


class SimulationStore:
    """The rows of one model on disk.

    A row is known by the exact bytes of its parameters. Failed rows are rows; a good row for the same
    parameters takes their place, and so does a newer failed one.
    """

    def __init__(
        self,
        folder: Path,
        *,
        model_digest: str,
        parameter_names: tuple[str, ...],
        output_names: tuple[str, ...],
        time: FloatArray,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        """Open a store; its folder is made when missing.

        Args:
            folder: Where the parts lie; one folder per model.
            model_digest: Digest of all that decides what the model answers to given parameters.
            parameter_names: Names of the p parameters.
            output_names: Names of the k outputs.
            time: Output times. Shape (t,). [s]
            on_warning: Told in one line of what was lost or set aside; logged when not given.

        Raises:
            InputError: If the folder belongs to another model or to another version of this program.
        """
        self._layout = Layout(model_digest, tuple(parameter_names), tuple(output_names), np.asarray(time))
        self._folder = Path(folder)
        files = StoreFolder(self._folder, self._layout)
        self._catalog = Catalog(files, self._layout, on_warning or _log.warning)
        self._dear_from = -np.inf

    @classmethod
    def at(cls, folder: Path, *, on_warning: Callable[[str], None] | None = None) -> "SimulationStore":
        """Open a store that exists.

        Args:
            folder: Where the parts lie.
            on_warning: Told in one line of what was lost or set aside.

        Raises:
            InputError: If there is none.
        """
        found = read_layout(folder)
        return cls(
            folder,
            model_digest=found.model_digest,
            parameter_names=found.parameter_names,
            output_names=found.output_names,
            time=found.time,
            on_warning=on_warning,
        )

    @property
    def folder(self) -> Path:
        """Where the parts lie."""
        return self._folder

    @property
    def rows_per_block(self) -> int:
        """Rows of a stream's blocks."""
        return max(1, BLOCK_BYTES // self._layout.row_bytes)

    @property
    def theta(self) -> FloatArray:
        """Parameters of all rows, in the order in which they are read fastest. Shape (n, p)."""
        self._catalog.refresh()
        return self._catalog.theta()

    def now(self) -> int:
        """Return a moment after all that is stored, and not after what will be. [µs since 1970]."""
        return self._catalog.now()

    def find(self, theta: FloatArray) -> BoolArray:
        """Say which rows are stored, failed ones included.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        self._catalog.refresh()
        return self._catalog.look_up(theta)[0]

    def find_failed(self, theta: FloatArray, *, before: int | None = None) -> BoolArray:
        """Say which rows are stored and failed.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            before: Only those written before this moment, since 1970. [µs]

        Returns:
            Shape (n,).
        """
        self._catalog.refresh()
        known, found = self._catalog.look_up(theta)
        return known & ~found.good & (True if before is None else found.written < before)

    def read(self, theta: FloatArray) -> Trajectories:
        """Read rows.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The rows in the order asked for, exactly as the model answered.

        Raises:
            LookupError: If a row is not stored, or was and has turned out damaged.
        """
        theta = np.ascontiguousarray(theta, dtype=np.float64)
        for _ in range(_PATIENCE):
            known, found = self._catalog.look_up(theta)
            if not known.all():
                self._catalog.refresh()
                known, found = self._catalog.look_up(theta)
            if not known.all():
                raise LookupError(f"{int((~known).sum())} of {len(theta)} rows are not in {self.folder}")
            answer = self._catalog.read(theta, found)
            if answer is not None:
                return answer
            self._catalog.refresh()
        raise LookupError(f"{self.folder}: parts vanish faster than they can be read")

    def stream(self, theta: FloatArray | None = None) -> Iterator[Trajectories]:
        """Read rows block by block, in bounded memory.

        Args:
            theta: Parameters, None for all rows. Shape (n, p). [per parameter]

        Yields:
            Consecutive blocks.

        Raises:
            LookupError: If a row is not stored.
        """
        theta = self.theta if theta is None else np.asarray(theta, dtype=np.float64)
        for start in range(0, len(theta), self.rows_per_block):
            yield self.read(theta[start : start + self.rows_per_block])

    def append(self, rows: Trajectories) -> None:
        """Store rows; when this returns they survive the death of any process.

        They survive that of the machine, too, unless they came within a second of the rows before: such rows
        are simulated again sooner than a disk is made to write them.

        Args:
            rows: Answers of this store's model.

        Raises:
            ValueError: If they are another model's.
            OSError: If they cannot be written; nothing of them is stored then.
        """
        layout = self._layout
        if (
            rows.parameter_names != layout.parameter_names
            or rows.output_names != layout.output_names
            or not np.array_equal(rows.time, layout.time)
        ):
            raise ValueError("these rows have other names or times than the store")
        if rows.n:
            moment = np.full(rows.n, self.now(), dtype=np.int64)
            rows = replace(rows, failures=tuple(_as_utf8(reason) for reason in rows.failures))
            self._catalog.add(Rows(rows, moment), synced=time.monotonic() > self._dear_from)
            self._catalog.merge_small()
            self._dear_from = time.monotonic() + _CHEAP_S

    def close(self) -> None:
        """Let go of all files; the store can be used on."""
        self._catalog.close()

    def __enter__(self) -> "SimulationStore":
        """Return the store."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the store."""
        self.close()


def _as_utf8(reason: str) -> str:
    """Return a reason as a file can hold it: what an FMU says may be in any encoding."""
    return reason.encode("utf-8", "backslashreplace").decode("utf-8")
