"""Arena: the rows of one batch in memory that processes share, or in a file that survives them all."""

import contextlib
import fcntl
import json
import math
import mmap
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from simulation.arrays import FloatArray
from simulation.errors import MachineError
from simulation.trajectories import Trajectories
from simulation.workers.arena_file import (
    HEADER,
    HEADER_BYTES,
    MAGIC,
    N_ROWS_AT,
    REASON_BYTES,
    SUFFIX,
    boot_id,
    layout,
    new_file,
    owned,
)


class RowState(IntEnum):
    """How far a row is; the process that simulates it writes this after everything else about it."""

    WAITING = 0
    RUNNING = 1
    GOOD = 2
    FAILED = 3


@dataclass(frozen=True, eq=False)
class Grid:
    """What the rows of a model look like.

    Attributes:
        parameter_names: Names of the p parameters.
        output_names: Names of the k outputs.
        time: Output times. Shape (t,). [s]
    """

    parameter_names: tuple[str, ...]
    output_names: tuple[str, ...]
    time: FloatArray

    @property
    def row_bytes(self) -> int:
        """Size of one row's outputs."""
        return 8 * len(self.time) * len(self.output_names)


class Arena:
    """Parameters, outputs, state, reason and times of rows, mapped by the owner and by its workers.

    Attributes:
        grid: What the rows look like.
        capacity: Most rows it holds.
        theta: Parameters. Shape (capacity, p). [per parameter]
        y: Outputs. Shape (capacity, t, k). [per output]
        states: A RowState per row. Shape (capacity,).
        owners: Number of the run that each row was last handed out with. Shape (capacity,).
        started: When each row began, on the monotonic clock. Shape (capacity,). [s]
        wall_s: How long each finished row took. Shape (capacity,). [s]
        path: Its file; None in memory.
    """

    def __init__(self, descriptor: int, path: Path | None = None) -> None:
        """Map an arena.

        Args:
            descriptor: The open file; the arena's from now on, unless this raises.
            path: Where it is, if anywhere.

        Raises:
            ValueError: If the file is no arena of this boot of this machine, or half of one.
        """
        self._descriptor = -1
        self.path = path
        self._owner = os.getpid()
        size = os.fstat(descriptor).st_size
        if size < HEADER_BYTES:
            raise ValueError("the file is too short for an arena")
        self._memory = mmap.mmap(descriptor, size)
        magic, boot, n_names, capacity, _, p, t, k = HEADER.unpack_from(self._memory)
        places, total = layout(n_names, capacity, p, t, k)
        # After the machine went down, a row may be marked as good whose outputs never reached the disk.
        if magic != MAGIC or boot.rstrip(b"\0") != boot_id() or size < total:
            raise ValueError("the file is no arena of this boot of this machine")
        parameters, outputs = json.loads(self._memory[HEADER_BYTES : HEADER_BYTES + n_names])
        self.capacity = int(capacity)
        self.grid = Grid(tuple(parameters), tuple(outputs), self._array("time", places, (t,)).copy())
        self.theta = self._array("theta", places, (capacity, p))
        self.started = self._array("started", places, (capacity,))
        self.wall_s = self._array("wall_s", places, (capacity,))
        self.states: npt.NDArray[np.uint8] = np.frombuffer(self._memory, np.uint8, capacity, places["states"])
        self.owners: npt.NDArray[np.uint32] = np.frombuffer(
            self._memory, np.uint32, capacity, places["owners"]
        )
        self._reasons = places["reasons"]
        self.y = self._array("y", places, (capacity, t, k))
        self._descriptor = descriptor

    def _array(self, name: str, places: dict[str, int], shape: tuple[int, ...]) -> FloatArray:
        flat: FloatArray = np.frombuffer(self._memory, np.float64, math.prod(shape), places[name])
        return flat.reshape(shape)

    @classmethod
    def create(cls, grid: Grid, capacity: int, *, spool: Path | None = None) -> "Arena":
        """Make an empty arena.

        Args:
            grid: What the rows look like.
            capacity: Most rows it shall hold.
            spool: Folder for a file that outlives this process; None for memory that goes with it.

        Raises:
            MachineError: If there is no room for it.
        """
        names = json.dumps([grid.parameter_names, grid.output_names]).encode()
        shape = (len(names), capacity, len(grid.parameter_names), len(grid.time), len(grid.output_names))
        places, size = layout(*shape)
        descriptor, path = -1, None
        try:
            descriptor, path = new_file(spool)
            if path is not None:
                # A full disk must be an error here and not a killed process at some later row.
                os.posix_fallocate(descriptor, 0, size)
            else:
                os.ftruncate(descriptor, size)
            os.pwrite(descriptor, names, HEADER_BYTES)
            os.pwrite(descriptor, np.ascontiguousarray(grid.time, dtype=np.float64).tobytes(), places["time"])
            header = HEADER.pack(MAGIC, boot_id(), shape[0], capacity, 0, *shape[2:])
            os.pwrite(descriptor, header, 0)
            return cls(descriptor, path)
        except BaseException as error:
            if path is not None:
                path.unlink(missing_ok=True)
            if descriptor >= 0:
                os.close(descriptor)
            if isinstance(error, OSError):
                much = f"{size / 1e6:.0f} MB" if size > 1e6 else f"{size / 1e3:.0f} kB"
                raise MachineError(
                    f"{spool or 'memory'}: no room for {much} of simulated rows ({error.strerror}); free some"
                ) from None
            raise

    @classmethod
    def attach(cls, address: str) -> "Arena":
        """Map an arena of another process.

        Args:
            address: Its address.
        """
        return cls(os.open(address, os.O_RDWR | os.O_CLOEXEC))

    @property
    def address(self) -> str:
        """Where other processes of this machine find it while it is open here."""
        return str(self.path) if self.path is not None else f"/proc/{os.getpid()}/fd/{self._descriptor}"

    @property
    def n(self) -> int:
        """Rows in use."""
        return int(struct.unpack_from("<q", self._memory, N_ROWS_AT)[0])

    def load(self, theta: FloatArray) -> None:
        """Replace all rows by new ones that wait.

        Args:
            theta: Their parameters, at most as many as the capacity. Shape (n, p). [per parameter]
        """
        self.clear()
        n = len(theta)
        self.theta[:n] = theta
        self.states[:n] = RowState.WAITING
        self.owners[:n] = 0
        self.started[:n] = self.wall_s[:n] = 0.0
        struct.pack_into("<q", self._memory, N_ROWS_AT, n)

    def clear(self) -> None:
        """Forget all rows: they are kept elsewhere now, or not wanted."""
        struct.pack_into("<q", self._memory, N_ROWS_AT, 0)

    def reason(self, row: int) -> str:
        """Return why a failed row failed; "" for any other."""
        if self.states[row] != RowState.FAILED:
            return ""
        at = self._reasons + row * REASON_BYTES
        return self._memory[at : at + REASON_BYTES].split(b"\0", 1)[0].decode("utf-8", "ignore")

    def fail(self, row: int, reason: str) -> None:
        """Mark a row as failed.

        Args:
            row: Its number.
            reason: Why, in one line.
        """
        self.y[row] = np.nan
        text = reason.encode("utf-8", "replace").replace(b"\0", b" ")[: REASON_BYTES - 1]
        at = self._reasons + row * REASON_BYTES
        self._memory[at : at + len(text) + 1] = text + b"\0"
        self.states[row] = RowState.FAILED

    def trajectories(self, *, copied: bool = False) -> Trajectories:
        """Return all rows in use, which must be finished.

        Args:
            copied: Whether y shall be a copy and not this memory.
        """
        answer = self._answer(slice(0, self.n))
        return replace(answer, y=answer.y.copy()) if copied else answer

    def finished(self) -> Trajectories:
        """Return a copy of the finished rows, in order."""
        rows = np.flatnonzero(self.states[: self.n] >= RowState.GOOD)
        return self._answer(rows)

    def _answer(self, chosen: Any) -> Trajectories:
        # Whoever set a row's state has looked at its outputs: once is enough.
        return Trajectories(
            theta=self.theta[chosen].copy(),
            y=self.y[chosen],
            time=self.grid.time,
            parameter_names=self.grid.parameter_names,
            output_names=self.grid.output_names,
            failures=tuple(self._reasons_of(chosen)),
        )

    def _reasons_of(self, chosen: Any) -> list[str]:
        rows = np.arange(self.capacity)[chosen]
        reasons = [""] * len(rows)
        for i in np.flatnonzero(self.states[rows] == RowState.FAILED).tolist():
            reasons[i] = self.reason(rows[i])
        return reasons

    def remove(self) -> None:
        """Give the memory or the file back; arrays taken from it stay valid. Twice does no harm."""
        if self.path is not None and self._descriptor >= 0 and os.getpid() == self._owner:
            self.path.unlink(missing_ok=True)
        self.release()

    def release(self) -> None:
        """Let go of a file but leave it, for recover_arenas to find its finished rows."""
        if self._descriptor >= 0 and os.getpid() == self._owner:
            # The mapping holds a duplicate of the descriptor, and with it the lock.
            with contextlib.suppress(OSError):
                fcntl.flock(self._descriptor, fcntl.LOCK_UN)
            os.close(self._descriptor)
            self._descriptor = -1

    def __del__(self) -> None:
        # Whoever is interrupted between two lines leaves one that nobody lets go of.
        self.release()


def recover_arenas(spool: Path) -> Iterator[Trajectories]:
    """Yield the finished rows of arenas whose owner is dead, or let go of them after an error.

    An arena is removed when the next is asked for: whoever asks has stored its rows.

    Args:
        spool: The folder of the arenas; it need not exist.

    Yields:
        The finished rows of one arena, failed ones with their reasons included.
    """
    for path in sorted(Path(spool).glob(f"*{SUFFIX}*")):
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            continue
        arena = None
        try:
            if not owned(descriptor):
                continue
            with contextlib.suppress(ValueError):
                arena = Arena(descriptor)
                finished = arena.finished()
                if finished.n:
                    yield finished
                del finished
            path.unlink(missing_ok=True)
        finally:
            if arena is None:
                os.close(descriptor)
            else:
                arena.release()
