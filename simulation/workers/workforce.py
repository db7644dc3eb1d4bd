"""The workers of one model: hired for work, replaced when they end, fewer where licences are few."""

import signal
import time
from collections.abc import Callable
from typing import Final

from simulation.errors import InputError
from simulation.foreign_code import ENDED_BY
from simulation.workers.execution import ExecutionPolicy
from simulation.workers.messages import Ended, Limits, Opened, Ran, Refused
from simulation.workers.nursery import Event, Nursery, NurseryEnded, Worker, error_of
from simulation.workers.recipe import Facts, Recipe, subject

# A refused licence may come free; a broken FMU stays broken, and its user waits for the message.
_FIRST_ATTEMPTS: Final = 2
_LATER_ATTEMPTS: Final = 6
_BACKOFF_S: Final = 0.25
_MAX_BACKOFF_S: Final = 30.0
_MAX_STARTS: Final = 10
_MIN_OPENING_S: Final = 60.0


class Workforce:
    """Worker processes for one recipe, as many as asked for and as can be had."""

    def __init__(
        self,
        make_model: Recipe,
        n_workers: int,
        *,
        policy: ExecutionPolicy,
        on_warning: Callable[[str], None],
    ) -> None:
        """Hire nobody yet.

        Args:
            make_model: Recipe for the model.
            n_workers: Most workers at once.
            policy: Time-outs and limits.
            on_warning: Told, in one line, when there are fewer workers than asked for.
        """
        self._make_model = make_model
        self._n_workers = n_workers
        self._policy = policy
        self._on_warning = on_warning
        self._nursery: Nursery | None = None
        self._n_refused = 0
        self._n_starts = 0
        self._not_before = 0.0
        self._has_warned = False
        self._has_warned_of_opening = False
        self._why_refused: Refused | None = None
        self.facts: Facts | None = None

    @property
    def workers(self) -> list[Worker]:
        """All workers whose model is open and that take work."""
        return [worker for worker in self._all if worker.is_open and not worker.is_leaving]

    @property
    def n_alive(self) -> int:
        """Workers that are open or opening."""
        return sum(not worker.is_leaving for worker in self._all)

    @property
    def n_processes(self) -> int:
        """Worker processes that exist."""
        return len(self._all)

    @property
    def is_opening(self) -> bool:
        """Whether some worker is opening its model."""
        return any(not (worker.is_open or worker.is_leaving) for worker in self._all)

    @property
    def _all(self) -> list[Worker]:
        return list(self._nursery.workers.values()) if self._nursery is not None else []

    def open(self) -> Facts:
        """Have at least one worker with an open model.

        Returns:
            What the model looks like.

        Raises:
            InputError: If the model cannot be opened.
            RuntimeError: If its recipe or its process is broken.
        """
        while not self.workers or self.facts is None:
            self.ask_for(1)
            self.wait(0.1)
        return self.facts

    def ask_for(self, n: int) -> None:
        """Hire until so many workers are open or opening, as far as that is possible now."""
        n = min(n, self._n_workers)
        if self.n_alive >= n or time.monotonic() < self._not_before:
            return
        if self._nursery is not None and not self._nursery.is_alive:
            if self._nursery.workers:
                # Their rows are given back as wait() buries them, all of them in one go.
                return
            self._nursery.close()
            self._nursery = None
        if self._nursery is None:
            self._nursery = self._new_nursery()
        # After a refusal one at a time: each attempt may take a licence from somebody.
        for _ in range(min(n - self.n_alive, 1 if self._n_refused else n)):
            self._nursery.hire()

    def _new_nursery(self) -> Nursery:
        """Start the process that workers are forked from; whatever killed the last may not do so again."""
        limits = Limits(self._policy.max_growth_mb, self._policy.max_rows_per_process, self._policy.opening_s)
        while True:
            self._n_starts += 1
            try:
                nursery = Nursery(self._make_model, limits)
            except NurseryEnded:
                if self._n_starts >= _MAX_STARTS:
                    raise
            else:
                if self._n_starts <= _MAX_STARTS:
                    return nursery
                nursery.close()
                raise RuntimeError(f"the process for simulations was lost {_MAX_STARTS} times in a row")

    def fire(self, worker: Worker) -> None:
        """Kill a worker."""
        worker.is_leaving = True
        if self._nursery is not None:
            self._nursery.fire(worker)

    def wait(self, timeout_s: float) -> list[tuple[Worker, Ran | Ended]]:
        """Wait for runs to end and workers to die.

        Args:
            timeout_s: Longest time to wait. [s]

        Returns:
            What happened to workers that were open; Ended is the last of a worker.

        Raises:
            InputError: If the model cannot be opened by anybody.
            RuntimeError: If its process is broken.
        """
        if self._nursery is None:
            time.sleep(max(0.0, min(timeout_s, self._not_before - time.monotonic())))
            return []
        told: list[tuple[Worker, Ran | Ended]] = []
        for worker, event in self._nursery.wait(timeout_s):
            if isinstance(event, Ran):
                worker.n_rows += event.n_rows
                worker.is_leaving |= event.wants_rest
            if isinstance(event, Ran) or (isinstance(event, Ended) and worker.is_open):
                told.append((worker, event))
            else:
                self._hear_of_opening(worker, event)
        self._look_at_openings()
        return told

    def _hear_of_opening(self, worker: Worker, event: Event) -> None:
        if isinstance(event, Opened):
            worker.is_open = True
            self.facts = event.facts
            self._n_refused = 0
            self._n_starts = 0
        elif isinstance(event, Refused):
            worker.is_leaving = True
            self._refused(event)
        elif isinstance(event, Ended) and event.exit_code is not None and not worker.is_leaving:
            if event.exit_code == -ENDED_BY and self._policy.opening_s is not None:
                self._has_hung(self._policy.opening_s)
            else:
                self._refused_for_users(f"opening it {how_it_ended(event)}; try it in another FMI tool")

    def _refused(self, why: Refused) -> None:
        """Try again later; give up where nobody works and nobody is likely to."""
        self._n_refused += 1
        self._not_before = time.monotonic() + min(_BACKOFF_S * 2 ** (self._n_refused - 1), _MAX_BACKOFF_S)
        n_open = len(self.workers)
        if n_open:
            if not self._has_warned:
                self._has_warned = True
                self._on_warning(
                    f"only {n_open} of {self._n_workers} processes can open the model at once, which go on: "
                    f"{why.line}"
                )
            return
        if self._n_refused >= (_FIRST_ATTEMPTS if self.facts is None else _LATER_ATTEMPTS):
            self._n_refused = 0
            raise error_of(why)

    def _look_at_openings(self) -> None:
        """Stop what does not open in time where there is a limit, and say so where there is none."""
        timeout_s = self._policy.timeout_s
        patience = max(timeout_s or 0.0, _MIN_OPENING_S)
        for worker in self._all:
            if worker.is_open or worker.is_leaving or time.monotonic() - worker.hired_at < patience:
                continue
            if timeout_s is not None:
                self.fire(worker)
                self._has_hung(patience)
            elif not self._has_warned_of_opening:
                self._has_warned_of_opening = True
                self._on_warning(
                    f"{subject(self._make_model)} has been opening for {patience:g} s; does it wait for a "
                    "licence? simulation.timeout_s stops it"
                )

    def _has_hung(self, patience_s: float) -> None:
        # Whoever hung will hang again, and nobody waits for that twice.
        self._n_refused = max(self._n_refused, _FIRST_ATTEMPTS - 1)
        self._refused_for_users(
            f"did not open within {patience_s:g} s and was stopped; raise simulation.timeout_s"
        )

    def _refused_for_users(self, what: str) -> None:
        self._refused(Refused(f"{subject(self._make_model)}: {what}", InputError))

    def close(self, *, at_once: bool = False) -> None:
        """End all workers; the next work hires new ones.

        Args:
            at_once: Kill them in the middle of a row.
        """
        # Whoever is interrupted again and again while a process starts has lost none.
        self._n_starts = 0
        if self._nursery is not None:
            self._nursery.close(at_once=at_once)
            self._nursery = None


def how_it_ended(ended: Ended) -> str:
    """Say how a process ended, for a reason.

    Args:
        ended: What is known.
    """
    said = f"; last message: {ended.last_line}" if ended.last_line else ""
    if ended.exit_code is None:
        return "ended with the process above it"
    if ended.out_of_memory:
        return "ran out of memory, and the system stopped its process"
    if ended.exit_code >= 0:
        return f"ended its process with exit code {ended.exit_code}{said}"
    try:
        name = signal.Signals(-ended.exit_code).name
    except ValueError:
        name = f"signal {-ended.exit_code}"
    return f"crashed its process ({name}){said}"
