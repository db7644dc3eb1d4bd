"""One arena's rows over the workers: who gets which, what became of each, and when to stop."""

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from simulation.arena import Arena, RowState
from simulation.execution import MIN_ROWS_TO_STOP, CampaignStopped, ExecutionPolicy
from simulation.nursery import Worker
from simulation.row_queue import RowQueue
from simulation.worker_messages import Ended, Ran, Why
from simulation.workforce import Workforce, how_it_ended

# Rows shorter than this are handed out before the last run is over, so that nobody waits for a message.
_QUEUE_BELOW_S: Final = 0.05
# Who is at one row for this long has what it was given besides taken away. [s]
_STUCK_S: Final = 0.5
# Another process must have this much to do to be worth opening the model once more.
START_PAYS_S: Final = 0.3
_TICK_S: Final = 0.1
_LOOK_S: Final = 0.05
_SLOW_FACTOR: Final = 20.0
_SLOW_S: Final = 60.0
_MAX_IDLE_DEATHS: Final = 5


@dataclass
class Record:
    """What a campaign has learnt, over all its arenas.

    Attributes:
        row_s: Recent time per row; None before the first. [s]
        n_finished: Rows finished in earlier arenas.
        n_failed: Those of them that failed.
        reasons: How often each reason occurred in earlier arenas.
        has_warned: Whether a slow row was reported.
    """

    row_s: float | None = None
    n_finished: int = 0
    n_failed: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    has_warned: bool = False


class Campaign:
    """The rows of one arena until all are finished."""

    def __init__(
        self,
        arena: Arena,
        number: int,
        workforce: Workforce,
        *,
        policy: ExecutionPolicy,
        record: Record,
        on_progress: Callable[[int], None] | None,
        on_warning: Callable[[str], None],
    ) -> None:
        """Take over an arena whose rows wait.

        Args:
            arena: The rows.
            number: A number that no other load of an arena has.
            workforce: Who simulates them.
            policy: How patiently.
            record: What is known from earlier arenas; kept up to date.
            on_progress: Told how many rows have finished, those of earlier arenas included.
            on_warning: Told, in one line, what a user should know at once.
        """
        self._arena = arena
        self._workforce = workforce
        self._policy = policy
        self._record = record
        self._on_progress = on_progress
        self._on_warning = on_warning
        self._n = arena.n
        self._queue = RowQueue(arena, number)
        self._n_crashes: Counter[int] = Counter()
        self._n_timeouts: Counter[int] = Counter()
        self._n_idle_deaths = 0
        self._reported = -1
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
        while not self._look_at_progress():
            self._hire()
            self._hand_out()
            for worker, event in self._workforce.wait(self._patience()):
                if isinstance(event, Ran):
                    self._ran(worker, event)
                else:
                    self._ended(worker, event)
            self._watch_the_clock()
        self._record.n_finished += self._n
        failed = np.flatnonzero(self._arena.states[: self._n] == RowState.FAILED)
        self._record.n_failed += len(failed)
        self._record.reasons.update(self._arena.reason(row) for row in failed.tolist())

    def _look_at_progress(self) -> bool:
        """Report what has finished; return whether all has, and every worker is free again."""
        now = time.monotonic()
        if self._queue.n_waiting and now - self._looked < _LOOK_S:
            return False
        self._looked = now
        states = self._arena.states[: self._n]
        n_failed = int(np.count_nonzero(states == RowState.FAILED))
        n_done = n_failed + int(np.count_nonzero(states == RowState.GOOD))
        if n_done != self._reported:
            self._reported = n_done
            if self._on_progress is not None:
                self._on_progress(self._record.n_finished + n_done)
            self._stop_if_hopeless(n_done + self._record.n_finished, n_failed + self._record.n_failed)
        return n_done == self._n and not any(worker.runs for worker in self._workforce.workers)

    def _stop_if_hopeless(self, n_finished: int, n_failed: int) -> None:
        allowed = self._policy.max_failed_share
        # Bad luck at the beginning, within two standard deviations, is no reason.
        surely = allowed * n_finished + 2.0 * math.sqrt(allowed * (1.0 - allowed) * n_finished)
        if n_finished < MIN_ROWS_TO_STOP or n_failed <= surely:
            return
        reasons = self._record.reasons + Counter(
            self._arena.reason(row)
            for row in np.flatnonzero(self._arena.states[: self._n] == RowState.FAILED).tolist()
        )
        commonest, n_times = reasons.most_common(1)[0]
        raise CampaignStopped(
            f"{n_failed} of {n_finished} simulations failed, more than simulation.max_failed_share = "
            f"{self._policy.max_failed_share:g} allows; the commonest reason ({n_times} times): {commonest}; "
            "narrow the bounds, mend the model or raise the share"
        )

    # Who works

    def _hire(self) -> None:
        """Ask for as many workers as the rows that nobody has begun are worth."""
        if not self._queue.n_waiting:
            return
        n = self._workforce.n_alive
        if n == 0:
            self._workforce.ask_for(1)
        elif self._workforce.workers and not self._workforce.is_opening:
            row_s = max(self._record.row_s or 0.0, self._longest_s)
            left_s = self._queue.n_waiting * row_s
            worth = n + min(self._queue.n_waiting, int(left_s / (n * START_PAYS_S)))
            if worth > n:
                self._workforce.ask_for(worth)

    def _hand_out(self) -> None:
        row_s = self._record.row_s
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
            row_s = ran.spent_s / ran.n_rows
            old = self._record.row_s
            # The first row may compile or load something.
            self._record.row_s = row_s if old is None else min(row_s, 0.5 * (old + row_s))
        elif ran.why is Why.FRESH:
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
            reason = f"did not answer within {policy.timeout_s:g} s and was stopped"
        elif worker.is_leaving or ended.exit_code is None:
            # Not this row's fault: it began just before its process was stopped for something else.
            arena.states[row] = RowState.WAITING
            return
        else:
            self._n_crashes[row] += 1
            n, allowed = self._n_crashes[row], policy.retries
            reason = f"the FMU {how_it_ended(ended)}"
        if n <= allowed:
            arena.states[row] = RowState.WAITING
        else:
            times = f"{n} times: " if n > 1 else ""
            arena.fail(row, times + reason)

    def _ended_between_rows(self, how: str) -> None:
        self._n_idle_deaths += 1
        if self._n_idle_deaths >= _MAX_IDLE_DEATHS:
            raise CampaignStopped(
                f"a process that should simulate {how}, {self._n_idle_deaths} times in a row without "
                "finishing a row; try the model in another FMI tool"
            )

    # The clock

    def _patience(self) -> float:
        timeout_s = self._policy.timeout_s
        return _TICK_S if timeout_s is None else min(_TICK_S, 0.25 * timeout_s)

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
        timeout_s = self._policy.timeout_s
        for worker, row, spent_s in running:
            if spent_s > _STUCK_S:
                for run in worker.runs:
                    self._queue.give_back(run)
            if timeout_s is not None and spent_s > timeout_s:
                self._timed_out[worker.number] = row
                self._workforce.fire(worker)
            elif spent_s > _SLOW_S and not self._record.has_warned:
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
        self._record.has_warned = True
        advice = (
            "a time-out is set with simulation.timeout_s"
            if self._policy.timeout_s is None
            else f"it will be stopped after {self._policy.timeout_s:g} s"
        )
        self._on_warning(
            f"row {self._record.n_finished + row} has been running for {duration(spent_s)}, the median is "
            f"{duration(median_s)}; {advice}"
        )


def duration(seconds: float) -> str:
    """Write a time for people.

    Args:
        seconds: The time. [s]
    """
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
