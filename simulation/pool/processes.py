"""Processes that simulate: asked from threads of this machine, or by an executor on another one."""

import contextlib
import pickle
import threading
import weakref
from collections import OrderedDict
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from os import getpid
from pathlib import Path
from time import monotonic
from typing import Any

from simulation.pool.execution import ExecutionPolicy
from simulation.pool.fork_server import KNOWN, hang_up, spawn_supervisor
from simulation.pool.worker_process import ChunkAnswer, Factory, Facts, Opened, Question

# For killing what is left and removing its files, however many they are and however slow the disk. [s]
_ENDING_S = 60.0


FILES: dict[str, Path] = {}
"""Where models' files lie that were sent to this machine, by SHA-256 of their content."""
# A thread keeps this many models open: each may hold a licence.
_KEPT_MODELS = 2
# Of each thread, the last one used at the end.
_kept = threading.local()


class ProcessLostError(RuntimeError):
    """A process that supervises simulations was killed; what it was asked can be asked of another."""


class Processes:
    """Supervised processes that have a model open, as many as threads ask at a time.

    Attributes:
        opened: Those that have the model open, and when they opened it, on the monotonic clock. [s]
    """

    def __init__(self, make_model: Factory, policy: ExecutionPolicy) -> None:
        """Set up; no process starts before the first question.

        Args:
            make_model: The model's factory, which other processes must be able to import.
            policy: What happens to rows that hang, crash or fail.
        """
        self._make_model = make_model
        self._policy = policy
        self._lock = threading.Lock()
        self._is_ending = False
        self._all: list[Connection] = []
        self.opened: dict[Connection, float] = {}
        self._idle: list[Connection] = []
        self._facts: Facts | None = None
        weakref.finalize(self, _close, self._all, getpid())

    @property
    def n(self) -> int:
        """Number of processes now."""
        return len(self._all)

    def simulate(self, question: Question) -> ChunkAnswer | Facts:
        """Have rows simulated.

        Args:
            question: The rows.

        Returns:
            What became of them; where there are none, what the model looks like.

        Raises:
            InputError: The model cannot be opened; a RuntimeError where that is a mistake in its code.
            ProcessLostError: The process was killed.
        """
        connection = self._taken()
        message: Any = None
        try:
            connection.send(question)
            while isinstance(message := connection.recv(), Opened):
                self.opened[connection], self._facts = monotonic(), message.facts
                KNOWN.add(message.known)
            if isinstance(message, Exception):
                raise message
        except Exception as error:
            message = None  # its traceback would keep itself, and these processes, alive
            with self._lock:
                self._all.remove(connection)
                self.opened.pop(connection, None)
            _close([connection], getpid())
            if isinstance(error, EOFError | OSError):
                raise ProcessLostError("killed") from None
            raise
        self._idle.append(connection)
        answer: ChunkAnswer = message
        return answer if len(question.theta) or self._facts is None else self._facts

    def _taken(self) -> Connection:
        with contextlib.suppress(IndexError):
            return self._idle.pop()
        with self._lock:
            if self._is_ending:
                raise ProcessLostError("ended")
            self._all.append(spawn_supervisor(self._make_model, self._policy))
            return self._all[-1]

    def end(self) -> None:
        """Have all processes end, now; a thread that waits for one gets a ProcessLostError."""
        with self._lock:
            self._is_ending = True
            for connection in self._all:
                hang_up(connection)

    def close(self) -> None:
        """End all processes and wait until they have gone; no thread may wait for an answer.

        Closing twice does no harm, and the next question starts new ones.
        """
        with self._lock:
            _close(self._all, getpid())
            self._idle.clear()
            self.opened.clear()
            self._is_ending = False


def _close(connections: list[Connection], owner: int) -> None:
    """End processes, unless this is a fork of the one that started them."""
    while connections and getpid() == owner:
        with connections.pop() as connection, contextlib.suppress(EOFError, OSError):
            hang_up(connection)
            while connection.poll(_ENDING_S):
                connection.recv()


@dataclass(frozen=True)
class RemoteModel:
    """A model on its way to another process.

    Attributes:
        make_model: Its factory, pickled.
        digest: SHA-256 of the content of its file, in hexadecimal; "" where that is used where it is.
        policy: What happens to rows that hang, crash or fail.
    """

    make_model: bytes
    digest: str
    policy: ExecutionPolicy

    def simulate(self, question: Question) -> ChunkAnswer | Facts:
        """Simulate rows in a supervised process of the machine that this is called on.

        Args:
            question: The rows.

        Returns:
            See Processes.simulate.
        """
        return self._processes().simulate(question)

    def _processes(self) -> Processes:
        # Not above: the traceback of an error there would keep the processes of all models alive.
        kept: OrderedDict[RemoteModel, Processes] = vars(_kept).setdefault("models", OrderedDict())
        if self not in kept:
            while len(kept) >= _KEPT_MODELS:
                kept.popitem(last=False)[1].close()
            make_model: Any = pickle.loads(self.make_model)
            if self.digest:
                owner = replace(make_model.__self__, path=FILES[self.digest])
                make_model = getattr(owner, make_model.__name__)
            kept[self] = Processes(make_model, self.policy)
        kept.move_to_end(self)
        return kept[self]
