"""The near end of worker processes: start one, hear it, kill it, and leave nothing of any behind."""

import contextlib
import socket
import time
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import send_handle
from typing import Any, Final

from simulation.workers.held_interrupts import interrupts_held
from simulation.workers.messages import (
    Ended,
    Fire,
    Hire,
    Hired,
    Learnt,
    Limits,
    Opened,
    Ran,
    Refused,
    Run,
)
from simulation.workers.nursery_process import let_rest, nursery_process
from simulation.workers.recipe import Recipe

_GRACE_S: Final = 1.0


@dataclass(eq=False)
class Worker:
    """One worker process.

    Attributes:
        number: Its number, never used again.
        connection: To it; closed when it has hung up.
        hired_at: When it was asked for, on the monotonic clock. [s]
        is_open: Whether its model is open.
        is_leaving: Whether it will end by itself, or has been told to.
        runs: What it has been given and not reported on, oldest first.
        n_rows: Rows that it has finished.
    """

    number: int
    connection: Connection
    hired_at: float
    pid: int | None = None
    is_open: bool = False
    is_leaving: bool = False
    runs: deque[Run] = field(default_factory=deque)
    n_rows: int = 0

    def give(self, run: Run) -> None:
        """Give it a run of rows, which it works off after those that it has."""
        self.runs.append(run)
        # One that has just died will be buried, and its runs given to another.
        with contextlib.suppress(OSError):
            self.connection.send(run)


Event = Opened | Refused | Ran | Ended


class NurseryEnded(RuntimeError):  # noqa: N818 - somebody's doing, perhaps not the model's
    """The process ended before it was ready."""


class Nursery:
    """A process that has imported a recipe's modules, and the workers that are forked from it."""

    def __init__(self, make_model: Recipe, limits: Limits) -> None:
        """Start the process, or take up the one that rests, and wait until it is ready.

        Args:
            make_model: Recipe for the model; must be picklable, and importable from a module.
            limits: When workers shall ask to be replaced.

        Raises:
            InputError: If the recipe's modules say so.
            RuntimeError: If they cannot be imported.
            NurseryEnded: If the process ends before it is ready.
        """
        self._next = 0
        self._is_closed = False
        self.workers: dict[int, Worker] = {}
        with interrupts_held() as release:
            self._process = nursery_process()
            self._control = self._process.control
            try:
                release()
                answer = self._process.give(make_model, limits)
            except (EOFError, OSError):
                said = self._process.said() or "killed"
                self.close(at_once=True)
                raise NurseryEnded(f"the process for simulations does not start: {said}") from None
            except BaseException:
                self.close(at_once=True)
                raise
        if isinstance(answer, Refused):
            self.close(at_once=True)
            raise error_of(answer)

    def hire(self) -> Worker:
        """Start a worker; an Opened, Refused or Ended tells what became of it."""
        near, far = socket.socketpair()
        worker = Worker(self._next, Connection(near.detach()), time.monotonic())
        self._next += 1
        self.workers[worker.number] = worker
        with far, contextlib.suppress(OSError):
            # Only now: where nobody follows, nobody needs it, and it would hold up the end.
            while self._process.untold:
                self._control.send(self._process.untold.pop())
            self._control.send(Hire(worker.number))
            send_handle(self._control, far.fileno(), self._process.process.pid)
        return worker

    def fire(self, worker: Worker) -> None:
        """Kill a worker; an Ended tells when it is gone."""
        with contextlib.suppress(OSError):
            self._control.send(Fire(worker.number))

    def wait(self, timeout_s: float) -> list[tuple[Worker, Event]]:
        """Wait for something to happen.

        Args:
            timeout_s: Longest time to wait. [s]

        Returns:
            What happened to whom, in an order that a worker's Ended is its last.
        """
        connections: dict[Any, Worker] = {
            worker.connection: worker for worker in self.workers.values() if not worker.connection.closed
        }
        ready = wait([self._control, *connections], timeout_s)
        events: list[tuple[Worker, Event]] = []
        for connection in ready:
            if connection is not self._control:
                worker = connections[connection]
                # One message: asking for more costs more than being told of them in the next round.
                events += [(worker, heard) for heard in self._from(worker.connection)]
        if self._control in ready:
            events += self._from_nursery()
        return events

    def _from_nursery(self) -> list[tuple[Worker, Event]]:
        events: list[tuple[Worker, Event]] = []
        try:
            while self._control.poll():
                message = self._control.recv()
                worker = self.workers[message.worker]
                if isinstance(message, Hired):
                    worker.pid = message.pid
                else:
                    events += self._bury(worker, message)
        except (EOFError, OSError):
            # Killed: its workers end as their connections close, and nobody can say how.
            self._process.process.wait()
            for worker in list(self.workers.values()):
                events += self._bury(worker, Ended(worker.number, None, ""))
        return events

    def _bury(self, worker: Worker, ended: Ended) -> list[tuple[Worker, Event]]:
        """Hear what the worker said last, and forget it."""
        heard: list[Event] = self._all_from(worker.connection)
        worker.connection.close()
        del self.workers[worker.number]
        return [(worker, event) for event in (*heard, ended)]

    def _from(self, connection: Connection) -> list[Any]:
        """Receive a message that lies ready; close the connection where there is nothing more to come."""
        try:
            message = connection.recv()
            if not isinstance(message, Learnt):
                return [message]
            if message.known not in self._process.known:
                self._process.known.add(message.known)
                self._process.untold.append(message)
        except (EOFError, OSError):
            connection.close()
        return []

    def _all_from(self, connection: Connection) -> list[Any]:
        messages: list[Any] = []
        while not connection.closed and connection.poll():
            messages += self._from(connection)
        return messages

    @property
    def is_alive(self) -> bool:
        """Whether it can hire."""
        return not self._is_closed and self._process.is_alive

    def close(self, *, at_once: bool = False) -> None:
        """End all workers and let the process rest; closing twice does no harm.

        Args:
            at_once: Kill all in the middle of what they do, instead of letting workers close their model.
        """
        if self._is_closed or not self._process.is_ours:
            return
        try:
            may_rest = not at_once and self._has_let_go()
            self._is_closed = True
            if may_rest:
                let_rest(self._process)
            else:
                self._process.end()
        except BaseException:
            self._process.end()
            raise
        finally:
            for worker in self.workers.values():
                worker.connection.close()
            self.workers.clear()

    def _has_let_go(self) -> bool:
        """Ask the workers to end, and tell whether all have done so soon."""
        deadline = time.monotonic() + _GRACE_S
        for worker in self.workers.values():
            with contextlib.suppress(OSError):
                worker.connection.send(None)
        while self.workers and (left := deadline - time.monotonic()) > 0 and self.is_alive:
            self.wait(left)
        return self.is_alive and not self.workers


def error_of(refused: Refused) -> Exception:
    """Return the exception for a model that cannot be opened.

    Args:
        refused: What its process said.
    """
    return refused.kind(refused.line)
