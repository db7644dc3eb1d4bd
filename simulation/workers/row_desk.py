"""How a worker works off a run of rows: straight into the arena, flagged one by one, never for too long."""

import contextlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any, Final, Protocol

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel
from simulation.workers.arena import Arena, RowState
from simulation.workers.messages import Ran, Run, Why

# Memory is looked at this often: a look costs some microseconds, as much as a small part of a row.
_LOOK_S: Final = 0.005
_MAX_LOG_BYTES: Final = 1_000_000
_PAGE_MB: Final = os.sysconf("SC_PAGE_SIZE") / 1e6


class _SimulateInto(Protocol):
    def __call__(
        self,
        theta: FloatArray,
        y: FloatArray,
        *,
        before: Callable[[int], None],
        after: Callable[[int, str], None],
    ) -> None: ...


class _EndOfRun(Exception):  # noqa: N818 - not an error
    def __init__(self, why: Why) -> None:
        super().__init__(why.value)
        self.why = why


class RowDesk:
    """The rows that one worker is given, with an eye on the clock and on its memory."""

    def __init__(self, model: ForwardModel, *, max_growth_mb: float, max_rows: int | None, log: Path) -> None:
        """Take a seat.

        Args:
            model: The open model.
            max_growth_mb: Growth since the first row after which the worker asks to be replaced. [MB]
            max_rows: Rows after which it does; None for never.
            log: What this process writes to the terminal, to be kept small.
        """
        self._simulate: _SimulateInto = getattr(model, "simulate_into", None) or _one_by_one(model)
        self._max_growth_mb = max_growth_mb
        self._max_rows = max_rows if max_rows is not None else sys.maxsize
        self._log = log
        self._memory = _Memory()
        self._first_mb: float | None = None
        self._looked = 0.0
        self._n_rows = 0
        self._arena: Arena | None = None
        self._arena_number = -1

    def work_off(self, run: Run) -> Ran:
        """Simulate the rows of a run; a row that raises is a failed row.

        Args:
            run: The run.

        Returns:
            How far it came.
        """
        arena = self._attached(run)
        # Views of memory are set several times as fast as items of arrays.
        states, started, wall_s = _view(arena.states), _view(arena.started), _view(arena.wall_s)
        owners, number = _view(arena.owners), run.number
        first = run.start
        begun = monotonic()
        deadline = begun + run.budget_s
        n_before = self._n_rows

        def before(i: int) -> None:
            now, row = monotonic(), first + i
            if (now > deadline and self._n_rows > n_before) or owners[row] != number:
                raise _EndOfRun(Why.LATE)
            started[row] = now
            states[row] = 1

        def after(i: int, reason: str) -> None:
            row = first + i
            now = monotonic()
            wall_s[row] = now - started[row]
            if reason:
                arena.fail(row, reason)
            else:
                states[row] = 2
            self._n_rows += 1
            if now - self._looked > _LOOK_S and self._has_grown(now):
                raise _EndOfRun(Why.RECYCLE)
            if self._n_rows >= self._max_rows:
                raise _EndOfRun(Why.RECYCLE)

        why = Why.DONE
        try:
            self._simulate(
                arena.theta[run.start : run.stop], arena.y[run.start : run.stop], before=before, after=after
            )
        except _EndOfRun as end:
            why = end.why
        except Exception as error:
            why = Why.FRESH
            self._settle(arena, run, error)
        if self._first_mb is None:
            self._first_mb = self._memory.mb()
        elif why in (Why.DONE, Why.LATE) and self._has_grown(monotonic()):
            why = Why.RECYCLE
        self._trim_log()
        return Ran(self._n_rows - n_before, monotonic() - begun, why)

    def _attached(self, run: Run) -> Arena:
        if self._arena is None or run.arena != self._arena_number:
            if self._arena is not None:
                self._arena.release()
            self._arena, self._arena_number = Arena.attach(run.address), run.arena
        return self._arena

    def _settle(self, arena: Arena, run: Run, error: Exception) -> None:
        """Decide about the row that raised: it failed, or only another process can answer it."""
        from simulation.fmi.runner import NeedsFreshProcess

        for row in range(run.start, run.stop):
            if arena.states[row] != RowState.RUNNING or arena.owners[row] != run.number:
                continue
            if isinstance(error, NeedsFreshProcess):
                arena.states[row] = RowState.WAITING
                return
            said = " ".join(str(error).split())
            arena.wall_s[row] = monotonic() - arena.started[row]
            arena.fail(
                row, "out of memory" if isinstance(error, MemoryError) else f"{type(error).__name__}: {said}"
            )
            self._n_rows += 1

    def _has_grown(self, now: float) -> bool:
        self._looked = now
        return self._first_mb is not None and self._memory.mb() - self._first_mb > self._max_growth_mb

    def _trim_log(self) -> None:
        with contextlib.suppress(OSError):
            if self._log.stat().st_size > _MAX_LOG_BYTES:
                os.truncate(self._log, 0)


def _view(array: Any) -> Any:
    return memoryview(array)


def _one_by_one(model: ForwardModel) -> _SimulateInto:
    """Give a model without simulate_into its rows one by one, so that each can be told apart."""

    def simulate_into(
        theta: FloatArray,
        y: FloatArray,
        *,
        before: Callable[[int], None],
        after: Callable[[int, str], None],
    ) -> None:
        for i in range(len(theta)):
            before(i)
            answer = model.simulate(theta[i : i + 1])
            y[i] = answer.y[0]
            after(i, answer.failures[0])

    return simulate_into


class _Memory:
    """Memory of this process that is its own: arenas, which it shares, do not count."""

    def __init__(self) -> None:
        self._pages = os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)

    def mb(self) -> float:
        _, resident, shared = os.pread(self._pages, 64, 0).split()[:3]
        return (int(resident) - int(shared)) * _PAGE_MB
