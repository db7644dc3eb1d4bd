"""A forward model spread over processes, for batches that are worth it."""

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.trajectories import Trajectories

# Starting workers costs a second or two of imports: only batches with more work than this earn it back.
POOL_PAYS_S: Final = 3.0
# Once the workers stand, a batch must still outweigh the transport of its rows.
SHARE_PAYS_S: Final = 0.05
_PIECE_S: Final = 0.5
# Trajectories travel through pipes at about this rate; a faster model is quicker alone.
_TRANSPORT_BYTES_PER_S: Final = 1e8
_PIECE_BYTES: Final = 8e6


class ParallelModel(WrappedModel):
    """A model that answers large batches with all cores and small ones in this process.

    The first rows are simulated here and timed. Workers start when the serial work seen so far in batches
    reaches pool_pays_s and a row takes longer than its transport; each builds its model once. A row whose
    process dies is a failed row like any other.
    """

    def __init__(
        self,
        make_model: Callable[[], ForwardModel],
        n_workers: int | None = None,
        *,
        pool_pays_s: float = POOL_PAYS_S,
    ) -> None:
        """Build the model for this process; no worker starts yet.

        Args:
            make_model: Recipe for the model; must be picklable.
            n_workers: Worker processes; None for one per core that this process may use.
            pool_pays_s: Serial work that earns back the start of workers; 0 starts them at once. [s]
        """
        if n_workers is not None and n_workers < 1:
            raise ValueError(f"n_workers is {n_workers}; at least one process has to work")
        super().__init__(make_model())
        self._make_model = make_model
        self._n_workers = n_workers or available_cores()
        self._pool_pays_s = pool_pays_s
        self._row_s: float | None = None
        self._spent_s = 0.0
        self._pool: ProcessPoolExecutor | None = None
        self._leash: Connection | None = None

    @property
    def n_workers(self) -> int:
        """Worker processes that a large batch gets."""
        return self._n_workers

    @property
    def pool_started(self) -> bool:
        """Whether workers stand ready."""
        return self._pool is not None

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row, on all cores where that pays.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The same trajectories as from one process, bit for bit.
        """
        theta = np.asarray(theta, dtype=np.float64)
        if self._n_workers == 1 or len(theta) < 2:
            return self._here(theta)
        parts: list[Trajectories] = []
        rest = theta
        # One row, then a few: the first may compile or load something, but a slow model shows after one.
        for n_probed in (1, 8) if self._row_s is None else ():
            if len(rest) and (self._row_s or 0.0) * n_probed < _PIECE_S:
                parts.append(self._here(rest[:n_probed]))
                rest = rest[n_probed:]
        if len(rest):
            parts.append(self._shared(rest) if self._pays(len(rest)) else self._here(rest))
        return Trajectories.concatenate(parts)

    def _here(self, theta: FloatArray) -> Trajectories:
        before = time.perf_counter()
        answer = self._model.simulate(theta)
        spent = time.perf_counter() - before
        if len(theta):
            self._row_s = min(spent / len(theta), self._row_s or np.inf)
        # Lonely rows (a line search) never share work, so they are no argument for workers.
        if len(theta) > 1:
            self._spent_s += spent
        return answer

    @property
    def _row_bytes(self) -> int:
        return 8 * len(self.time) * len(self.output_names)

    def _pays(self, n: int) -> bool:
        row_s = self._row_s or 0.0
        expected_s = n * row_s
        if self._pool_pays_s <= 0.0:
            return True
        if expected_s < SHARE_PAYS_S or row_s < 2 * self._row_bytes / _TRANSPORT_BYTES_PER_S:
            return False
        return self._pool is not None or self._spent_s + expected_s >= self._pool_pays_s

    def _shared(self, theta: FloatArray) -> Trajectories:
        """Split rows over the workers; pieces of about half a second keep all of them busy to the end."""
        most = max(1, int(min(_PIECE_S / max(self._row_s or 0.0, 1e-9), _PIECE_BYTES / self._row_bytes)))
        size = min(most, -(-len(theta) // self._n_workers))
        pieces = [theta[start : start + size] for start in range(0, len(theta), size)]
        pool = self._pool or self._start(self._n_workers)
        futures = _submit(pool, pieces)
        parts: list[Trajectories | None] = []
        for future in futures:
            try:
                parts.append(future.result())
            except BrokenProcessPool:
                parts.append(None)
        if any(part is None for part in parts):
            self._stop()
        return Trajectories.concatenate(
            [
                part if part is not None else self._one_by_one(piece)
                for part, piece in zip(parts, pieces, strict=True)
            ]
        )

    def _one_by_one(self, theta: FloatArray) -> Trajectories:
        """Find the row that killed a worker: one row at a time in one worker, which may die again."""
        parts = []
        for row in theta[:, None, :]:
            try:
                parts.append(_submit(self._pool or self._start(1), [row])[0].result())
            except BrokenProcessPool:
                self._stop()
                parts.append(self._dead(row))
        self._stop()
        return Trajectories.concatenate(parts)

    def _dead(self, row: FloatArray) -> Trajectories:
        return Trajectories.checked(
            row,
            np.full((1, len(self.time), len(self.output_names)), np.nan),
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
            failures=["the process that simulated this row died"],
        )

    def _start(self, n_workers: int) -> ProcessPoolExecutor:
        # Spawned, never forked: a loaded FMU and its threads do not survive a fork.
        context = multiprocessing.get_context("spawn")
        hold, self._leash = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(
            n_workers, mp_context=context, initializer=_start_worker, initargs=(self._make_model, hold)
        )
        try:
            self._pool.submit(_ready).result()
        except BrokenProcessPool:
            self._stop()
            raise RuntimeError(
                "worker processes do not start; a script must start its work under "
                'if __name__ == "__main__", or use n_workers=1'
            ) from None
        return self._pool

    def _stop(self) -> None:
        """Let go of the leash: workers end at once, in the middle of a row if need be."""
        if self._leash is not None:
            self._leash.close()
            self._leash = None
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def close(self) -> None:
        """End the workers and close the model; closing twice does no harm."""
        self._stop()
        close = getattr(self._model, "close", None)
        if close is not None:
            close()

    def __enter__(self) -> "ParallelModel":
        """Return the model."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the model."""
        self.close()


def available_cores() -> int:
    """Count the cores that this process may use.

    Returns:
        At least 1.
    """
    with contextlib.suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def exit_with_parent(*others: Connection) -> None:
    """Make this process end at once when the process that started it ends, however that happens.

    For the first line of a worker. Without it, workers of a killed parent go on for ever.

    Args:
        others: Connections whose far end, when closed, ends this process too.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    watched: list[Any] = [parent.sentinel, *others]

    def watch() -> None:
        wait(watched)
        # Not sys.exit: nothing here is worth finishing, and only the main thread could.
        os._exit(1)

    threading.Thread(target=watch, name="exit-with-parent", daemon=True).start()


def _submit(pool: ProcessPoolExecutor, pieces: list[FloatArray]) -> list[Future[Trajectories]]:
    return [pool.submit(_simulate_piece, piece) for piece in pieces]


# The model of a worker process; only _start_worker sets it.
_worker_model: list[ForwardModel] = []


def _start_worker(make_model: Callable[[], ForwardModel], leash: Connection) -> None:
    exit_with_parent(leash)
    # Ctrl-C reaches the whole group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker_model[:] = [make_model()]


def _ready() -> None:
    """Do nothing: a worker that gets here has built its model."""


def _simulate_piece(theta: FloatArray) -> Trajectories:
    return _worker_model[0].simulate(theta)
