"""One arena's rows over the workers: who gets which, what became of each, and when to stop."""

import math
import signal
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

import numpy as np

from simulation.workers.arena import Arena, RowState
from simulation.workers.execution import CampaignStopped, ExecutionPolicy
from simulation.workers.messages import Ended, Ran, Why
from simulation.workers.nursery import Worker
from simulation.workers.row_queue import RowQueue
from simulation.workers.tally import Speed, Tally
from simulation.workers.workforce import Workforce, how_it_ended

# A run this long hides the message that hands it out, and this short keeps all workers busy to the end.
_RUN_S: Final = 0.02
_MIN_RUN_S: Final = 0.002
# Rows shorter than this are handed out before the last run is over, so that nobody waits for a message.
_QUEUE_BELOW_S: Final = 0.05
# Nothing kills itself like this: the row was only there when somebody from outside came.
_MERCY: Final = 3
# Who is at one row for this long has what it was given besides taken away. [s]
_STUCK_S: Final = 0.5
# Another process must have this much to do to be worth opening the model once more.
START_PAYS_S: Final = 0.3
# A first row that is still running may be compiling or loading something, but not for this long. [s]
_SURELY_SLOW_S: Final = 2.0
_TICK_S: Final = 0.1
_LOOK_S: Final = 0.05
_SLOW_FACTOR: Final = 20.0
_SLOW_S: Final = 60.0
_MAX_IDLE_DEATHS: Final = 5


class Campaign:
    """The rows of one arena until all are finished."""

    def __init__(
        self,
        arena: Arena,
        number: int,
        workforce: Workforce,
        *,
        policy: ExecutionPolicy,
        tally: Tally,
        speed: Speed,
        on_warning: Callable[[str], None],
    ) -> None:
        """Take over an arena whose rows wait.

        Args:
            arena: The rows.
            number: A number that no other load of an arena has.
            workforce: Who simulates them.
            policy: How patiently.
            tally: What has finished; kept up to date.
            speed: How long rows take; kept up to date.
            on_warning: Told, in one line, what a user should know at once.
        """
        self._arena = arena
        self._workforce = workforce
        self._policy = policy
        self._tally = tally
        self._speed = speed
        self._on_warning = on_warning
        self._n = arena.n
        self._queue = RowQueue(arena, number, run_s=_RUN_S, min_run_s=_MIN_RUN_S)
        self._n_crashes: Counter[int] = Counter()
        self._n_timeouts: Counter[int] = Counter()
        self._n_idle_deaths = 0
        self._looked = self._watched = 0.0
        self._longest_s = 0.0
        self._timed_out: dict[int, int] = {}
        self._quiet_since: dict[int, float] = {}

    def run(self) -> None:
        """Simulate all rows.

        Raises:
            CampaignStopped: If too many fail.
            InputError: If the model cannot be opened.
        """
        while not self._is_over():
            self._hire()
            self._hand_out()
            for worker, event in self._workforce.wait(self._patience()):
                if isinstance(event, Ran):
                    self._ran(worker, event)
                else:
                    self._ended(worker, event)
            self._watch_the_clock()

    def _is_over(self) -> bool:
        """Look at what has finished; return whether all has, and every worker is free again."""
        now = time.monotonic()
        if self._queue.n_waiting and now - self._looked < _LOOK_S:
            return False
        self._looked = now
        return self._tally.look_at(self._arena) and not any(worker.runs for worker in self._workforce.workers)

    # Who works

    def _hire(self) -> None:
        """Ask for as many workers as the rows that nobody has begun are worth."""
        if not self._queue.n_waiting:
            return
        n = self._workforce.n_alive
        if n == 0:
            self._workforce.ask_for(1)
        elif self._workforce.workers and not self._workforce.is_opening:
            row_s = self._speed.row_s or 0.0
            if self._longest_s > _SURELY_SLOW_S:
                row_s = max(row_s, self._longest_s)
            left_s = self._queue.n_waiting * row_s
            worth = n + min(self._queue.n_waiting, int(left_s / (n * START_PAYS_S)))
            if worth > n:
                self._workforce.ask_for(worth)

    def _hand_out(self) -> None:
        row_s = self._speed.row_s
        depth = 2 if row_s is not None and row_s < _QUEUE_BELOW_S else 1
        for level in range(depth):
            for worker in self._workforce.workers:
                if self._queue.n_waiting and len(worker.runs) == level:
                    worker.give(self._queue.take(row_s, self._workforce.n_alive))

    # What became of rows

    def _ran(self, worker: Worker, ran: Ran) -> None:
        run = worker.runs.popleft()
        self._quiet_since.pop(worker.number, None)
        if ran.n_rows:
            self._n_idle_deaths = 0
            self._speed.saw(ran.n_rows, ran.spent_s)
        elif ran.why is Why.FRESH and not worker.n_rows:
            # One that has answered rows is one of many that may end together, and has done its part.
            self._ended_between_rows("asked for another process")
        self._queue.give_back(run)

    def _ended(self, worker: Worker, ended: Ended) -> None:
        """Find the row that a dead worker was at, and decide about it."""
        is_mystery = bool(worker.runs) and not worker.is_leaving and ended.exit_code is not None
        for run in worker.runs:
            for row in self._queue.rows(run, RowState.RUNNING):
                self._lost(row, worker, ended)
                is_mystery = False
            self._queue.give_back(run)
        worker.runs.clear()
        if is_mystery:
            self._ended_between_rows(how_it_ended(ended))

    def _lost(self, row: int, worker: Worker, ended: Ended) -> None:
        arena, policy = self._arena, self._policy
        arena.wall_s[row] = time.monotonic() - arena.started[row]
        if self._timed_out.pop(worker.number, None) == row:
            self._n_timeouts[row] += 1
            n, allowed = self._n_timeouts[row], policy.timeout_retries
            reason = policy.why_stopped(self._speed.slowest_s)
        elif worker.is_leaving or ended.exit_code is None:
            # Not this row's fault: it began just before its process was stopped for something else.
            arena.states[row] = RowState.WAITING
            return
        else:
            self._n_crashes[row] += 1
            n, allowed = self._n_crashes[row], policy.retries
            if ended.exit_code == -signal.SIGKILL and not ended.out_of_memory:
                allowed += _MERCY
            reason = f"the FMU {how_it_ended(ended)}"
        if n <= allowed:
            arena.states[row] = RowState.WAITING
        else:
            times = f"{n} times: " if n > 1 else ""
            arena.fail(row, times + reason)

    def _ended_between_rows(self, how: str) -> None:
        self._n_idle_deaths += 1
        if self._n_idle_deaths >= _MAX_IDLE_DEATHS:
            timeout_s = self._policy.timeout_s
            raise_it = "" if timeout_s is None else f"timeout_s = {timeout_s:g} may be too short, or "
            raise CampaignStopped(
                f"a process that should simulate {how}, {self._n_idle_deaths} times in a row without "
                f"finishing a row; {raise_it}try the model in another FMI tool"
            )

    # The clock

    def _patience(self) -> float:
        return min(_TICK_S, 0.25 * self._policy.limit_s(self._speed.slowest_s))

    def _running(self) -> list[tuple[Worker, int, float]]:
        """Return the workers that are at a row, the row, and for how long. [s]."""
        now = time.monotonic()
        return [
            (worker, row, now - float(self._arena.started[row]))
            for worker in self._workforce.workers
            for run in worker.runs
            for row in self._queue.rows(run, RowState.RUNNING)
        ]

    def _watch_the_clock(self) -> None:
        now = time.monotonic()
        if now - self._watched < self._patience():
            return
        self._watched = now
        running = self._running()
        self._longest_s = max((spent_s for _, _, spent_s in running), default=0.0)
        limit_s = self._policy.limit_s(self._speed.slowest_s)
        for worker, row, spent_s in running:
            if spent_s > _STUCK_S:
                for run in worker.runs:
                    self._queue.give_back(run)
            if spent_s > limit_s:
                self._timed_out[worker.number] = row
                self._workforce.fire(worker)
            elif spent_s > _SLOW_S and not self._tally.has_warned:
                self._warn_of_slow_row(row, spent_s)
        self._stop_what_hangs_between_rows({worker.number for worker, _, _ in running}, now)

    def _stop_what_hangs_between_rows(self, at_a_row: set[int], now: float) -> None:
        if self._policy.timeout_s is None:
            return
        for worker in self._workforce.workers:
            if worker.runs and worker.number not in at_a_row:
                if now - self._quiet_since.setdefault(worker.number, now) > self._policy.timeout_s:
                    self._workforce.fire(worker)
                    self._ended_between_rows("hung")
            else:
                self._quiet_since.pop(worker.number, None)

    def _warn_of_slow_row(self, row: int, spent_s: float) -> None:
        finished = self._arena.wall_s[: self._n][self._arena.states[: self._n] >= RowState.GOOD]
        if not len(finished) or spent_s < _SLOW_FACTOR * (median_s := float(np.median(finished))):
            return
        self._tally.has_warned = True
        limit_s = self._policy.limit_s(self._speed.slowest_s)
        advice = (
            f"it will be stopped after {limit_s:.4g} s"
            if math.isfinite(limit_s)
            else "a time-out is set with simulation.timeout_s"
        )
        self._on_warning(
            f"row {self._tally.n_finished + row} has been running for {duration(spent_s)}, the median "
            f"is {duration(median_s)}; {advice}"
        )


def duration(seconds: float) -> str:
    """Write a time for people.

    Args:
        seconds: The time. [s]
    """
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
