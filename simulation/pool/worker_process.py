"""What a worker process does: a factory opens its model, and rows go into memory that outlives it.

What one worker had to compile is handed on to those that come after it.
"""

import contextlib
import importlib
import math
import mmap
import os
import pickle
import pickletools
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, NoReturn

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import InputError
from simulation.fmi.runner import FmuProcessEnded, NeedsFreshProcess
from simulation.foreign_code import opening_limited
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from simulation.pool.family import end_with_parent
from simulation.scratch import own_temporary_folder

Factory = Callable[[], ForwardModel]


@dataclass(frozen=True, eq=False)
class Facts:
    """What is known of a model without simulating.

    Attributes:
        parameter_space: Its parameters.
        output_names: Its outputs.
        time: Its output times. Shape (t,). [s]
    """

    parameter_space: ParameterSpace
    output_names: tuple[str, ...]
    time: FloatArray


def known_facts(make_model: Factory) -> Facts | None:
    """Return what the owner of a factory declares of its model; None where only the open model knows.

    Args:
        make_model: The factory; its owner is the object that it is a bound method of.
    """
    try:
        owner: Any = getattr(make_model, "__self__", None)
        return Facts(owner.parameter_space, owner.output_names, owner.time)
    except AttributeError:
        return None


def subject(make_model: Factory) -> str:
    """Return what errors about opening a model are about: its file, where there is one.

    Args:
        make_model: The factory.
    """
    return str(getattr(getattr(make_model, "__self__", None), "path", make_model))


def prepare(make_model: Factory) -> None:
    """Read and compile what every process would need again to open a model, for forks of this one.

    Args:
        make_model: The factory; its owner may have a method `prepare`.
    """
    # At worst, every worker does it for itself, and says what is wrong.
    with contextlib.suppress(Exception):
        getattr(getattr(make_model, "__self__", None), "prepare", lambda: None)()


def packed(make_model: Factory) -> bytes:
    """Return a factory as bytes for another process.

    Args:
        make_model: The factory.

    Raises:
        RuntimeError: If no other process could read it.
    """
    try:
        content = pickle.dumps(make_model)
    except Exception as error:
        said = " ".join(str(error).split())
        raise RuntimeError(
            f"the factory {make_model!r} cannot be sent to worker processes ({said}); give a function of a "
            "module, or a method of an object that can be pickled"
        ) from error
    if any(argument == "__main__" for _, argument, _ in pickletools.genops(content)):
        raise RuntimeError(
            f"the factory {make_model!r} is defined in the script itself, where worker processes cannot find "
            "it; move it to a module"
        )
    return content


LOG = "log"
MAX_CHUNK_BYTES = 8_000_000
"""Outputs that a chunk has at most, unless one row has more."""


class NewProcess(Enum):
    """Which rows of a chunk begin in a process in which the model has answered no other row."""

    WHEN_NEEDED = "rows share the process that is there; it starts the FMU over between them"
    AT_FIRST = "the first row has a new process, which the others share"
    EACH_ROW = "each row has a process of its own"


class Question(NamedTuple):
    """Rows to be simulated.

    Attributes:
        theta: Parameters; without rows, what the model looks like is asked. Shape (n, p). [per parameter]
        budget_s: Time after which no further row is begun. [s]
        slowest_s: See ExecutionPolicy.limit_s. [s]
        new_process: Which rows are the first of their process.
    """

    theta: FloatArray
    budget_s: float
    slowest_s: float | None
    new_process: NewProcess = NewProcess.WHEN_NEEDED


class End(Enum):
    """How a worker came to the end of what it was given."""

    DONE = "all rows are finished, or the time is up"
    LEAVES = "it ends, and the next row needs another process"
    HUNG = "a row took longer than its time-out"
    DIED = "the process ended by itself"


@dataclass(frozen=True)
class Opened:
    """From a worker and its supervisor: the model is open.

    Attributes:
        facts: What it looks like.
        known: What the worker has compiled for it, see learnt().
    """

    facts: Facts
    known: bytes


@dataclass(frozen=True)
class ChunkAnswer:
    """From a supervisor: what became of the first rows of a chunk; the others are to be asked again.

    Attributes:
        y: Outputs, NaN throughout in failed rows. Shape (m, t, k). [per output]
        failures: Why each row failed; "" where it is good. Length m, at least 1.
        row_s: Time per row that did not end its process; None for no such row. [s]
        is_first: Which rows were the first of their process. Shape (m,).
        opening_s: Least time that a process has taken to start and to open the model; infinite for none. [s]
    """

    y: FloatArray
    failures: tuple[str, ...]
    row_s: float | None
    is_first: BoolArray
    opening_s: float = math.inf


class SharedRows:
    """Memory of a supervisor and its workers, without a name.

    Attributes:
        capacity: Rows that it holds; 0 before the model is known.
        y: Their outputs. Shape (capacity, t, k).
        begun: How many were begun. Shape (1,).
        done: How many are finished. Shape (1,).
        started: When the last one was begun, on the monotonic clock. Shape (1,). [s]
        spent: How long the finished ones took. Shape (1,). [s]
    """

    capacity = 0

    def __init__(self) -> None:
        self._descriptor = os.memfd_create("rows")

    def map(self, facts: Facts) -> None:
        """Make room for rows of a model; the second time nothing changes."""
        if self.capacity:
            return
        shape = len(facts.time), len(facts.output_names)
        size = shape[0] * shape[1]
        self.capacity = max(1, MAX_CHUNK_BYTES // (8 * size))
        os.ftruncate(self._descriptor, 8 * (4 + self.capacity * size))
        memory: FloatArray = np.frombuffer(mmap.mmap(self._descriptor, 0), np.float64)
        self.begun, self.done, self.started, self.spent, rows = np.split(memory, [1, 2, 3, 4])
        self.y = rows.reshape(self.capacity, *shape)


def work(
    connection: Connection, make_model: Factory, folder: Path, rows: SharedRows, opening_s: float | None
) -> None:
    """Be a worker: open the model, then simulate what comes.

    Args:
        connection: To the supervisor.
        make_model: The model's factory.
        folder: A folder for all that the FMU writes, which goes with the worker.
        rows: Where outputs go.
        opening_s: Time that the FMU's own code may take at a time while it is opened; None for ever. [s]
    """
    end_with_parent(signal.SIGKILL)
    log = os.open(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
    own_temporary_folder()
    # When memory ends, the system shall stop this process and not the one that keeps the results.
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")
    try:
        with opening_limited(opening_s):
            model = make_model()
        facts = Facts(model.parameter_space, model.output_names, model.time)
    except FmuProcessEnded as ended:
        _end_like(ended)
    except Exception as error:
        connection.send(refusal(error))
        return
    os.chdir(folder)
    rows.map(facts)
    connection.send(Opened(facts, learnt()))
    end = End.DONE
    with contextlib.suppress(EOFError):  # nothing more to do
        while end is End.DONE:
            theta, deadline = connection.recv()
            end = _simulate(model, theta, deadline, rows, connection)
            connection.send(end)
    if close := getattr(model, "close", None):
        close()


def refusal(error: Exception) -> Exception:
    """Return the error to report where a model could not be opened.

    Args:
        error: The error.
    """
    if isinstance(error, InputError):
        return error
    return RuntimeError("".join(traceback.format_exception(error)))


def _simulate(
    model: ForwardModel, theta: FloatArray, deadline: float, rows: SharedRows, connection: Connection
) -> End:
    """Simulate rows, at least one; none is begun after the deadline. [s].

    Reasons of failed rows are sent at once: who crashes later takes nothing along.
    """
    for i in range(len(theta)):
        rows.started[0] = now = monotonic()
        if i and now > deadline:
            break
        rows.begun[0] = i + 1
        is_broken = False
        try:
            answer = model.simulate(theta[i : i + 1])
            rows.y[i], reason = answer.y[0], answer.failures[0]
        except NeedsFreshProcess:
            return End.LEAVES
        except FmuProcessEnded as ended:
            _end_like(ended)
        except Exception as error:
            is_broken, said = True, " ".join(str(error).split())
            reason = "out of memory" if isinstance(error, MemoryError) else f"{type(error).__name__}: {said}"
            rows.y[i] = np.nan
        if reason:
            connection.send((i, reason))
        rows.spent[0] += monotonic() - now
        rows.done[0] = i + 1
        if is_broken:
            return End.LEAVES
    return End.DONE


def _end_like(ended: FmuProcessEnded) -> NoReturn:
    """End this process as the FMU's own process has ended; who supervises it says so and tries again."""
    if ended.exit_code == -signal.SIGKILL:
        os.kill(os.getpid(), signal.SIGKILL)
    os._exit(ended.exit_code % 256 or 1)


ROOM = "simulation"


def learnt() -> bytes:
    """Return what machine code this process has in memory.

    Returns:
        For remember() in another process; names and signatures, no code.
    """
    return pickle.dumps([(module, name, loop.signatures) for module, name, loop in _loops()])


def remember(known: bytes) -> None:
    """Compile in this process, mostly from numba's cache on disk, what another had learnt.

    Args:
        known: From learnt().
    """
    for module, name, signatures in pickle.loads(known):
        for signature in signatures:
            # At worst, every worker compiles it for itself.
            with contextlib.suppress(Exception):
                getattr(importlib.import_module(module), name).compile(signature)


def _loops() -> Iterator[tuple[str, str, Any]]:
    """Find the functions that numba compiles when they are first called; without importing numba."""
    for module in [name for name in sys.modules if name.partition(".")[0] == ROOM]:
        for name, value in list(vars(sys.modules[module]).items()):
            if type(value).__module__.startswith("numba.") and hasattr(value, "signatures"):
                yield module, name, value
