"""The process that workers are forked from, kept between two campaigns: its imports take a second.

Whoever is done with it lets it rest, and the next campaign in the same surroundings takes it up. One rests at
most; it ends by itself when nobody comes, and with the process that started it.
"""

import atexit
import contextlib
import os
import resource
import socket
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Final, Self

from simulation.workers.messages import Learnt, Limits, Rest, Rested, Task
from simulation.workers.recipe import Recipe, packed
from simulation.workers.safe_start import as_for_fmus

# Rows are spread over processes: threads below that would only get into each other's way.
_THREADS: Final = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# Variables that are read when a process starts or imports; all others can change while it lives.
_READ_AT_START: Final = (
    *("GLIBC_", "GOMP_", "KMP_", "LANG", "LC_", "LD_", "MALLOC_"),
    *("MKL_", "NPY_", "NUMBA_", "OMP_", "OPENBLAS_", "PYTHON", "TZ"),
)
# For killing what is left and removing its files, however many they are and however slow the disk. [s]
_END_S: Final = 60.0
# For doing the same where there is nothing left to kill. [s]
_REST_S: Final = 5.0
# Longest rest. [s]
_PATIENCE_S: Final = 60.0
# What `python -c` runs, given a descriptor and sys.path.
_BOOTSTRAP: Final = (
    "import sys; sys.path[:] = sys.argv[2:]; "
    "from simulation.workers.worker import main; main(int(sys.argv[1]))"
)


@dataclass(eq=False)
class NurseryProcess:
    """The process, which belongs to the process that started it and to one campaign at a time.

    Attributes:
        process: As the system knows it.
        control: The connection to it.
        known: What workers have found out so far.
        untold: The part of it that it has not been told.
    """

    process: subprocess.Popen[bytes]
    control: Connection
    _log: IO[bytes]
    known: set[bytes] = field(default_factory=set)
    untold: list[Learnt] = field(default_factory=list)
    _owner: int = field(default_factory=os.getpid)
    _log_begin: int = 0
    _start: object = field(default_factory=lambda: _given_at_start())

    @classmethod
    def started(cls) -> Self:
        """Start one; it imports nothing before its first task."""
        near, far = socket.socketpair()
        log = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        with far:
            process = subprocess.Popen(
                _command(far.fileno()),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=[far.fileno()],
                env=_environment(),
                # Ctrl-C reaches only the process that decides what it means.
                start_new_session=True,
            )
        return cls(process, Connection(near.detach()), log)

    @property
    def is_ours(self) -> bool:
        """Whether this process started it, and not one that this was forked from."""
        return os.getpid() == self._owner

    @property
    def is_alive(self) -> bool:
        """Whether it can work."""
        return not self.control.closed and self.process.poll() is None

    def fits(self, start: object) -> bool:
        """Tell whether it rests well, and one that is started now would be the same."""
        # It says nothing while it rests, but that it ends.
        return self.is_alive and not self.control.poll() and self._start == start

    def give(self, make_model: Recipe, limits: Limits) -> object:
        """Give it a task and return what it answers.

        Args:
            make_model: Recipe for the model.
            limits: When workers shall ask to be replaced.

        Raises:
            RuntimeError: The recipe cannot be sent.
            EOFError: It has ended.
            OSError: It has ended.
        """
        self.control.send(Task(packed(make_model), limits, _environment(), _working_folder()))
        answer: object = self.control.recv()
        return answer

    def said(self) -> str:
        """Return what it has written since it rested last."""
        self._log.seek(self._log_begin)
        return self._log.read().decode("utf-8", "replace").strip()

    def rest(self) -> bool:
        """Have it clear its place, and return whether it has; no worker may be left."""
        try:
            self.control.send(Rest(_PATIENCE_S))
            while self.control.poll(_REST_S):
                if isinstance(self.control.recv(), Rested):
                    self._log_begin = self._log.seek(0, os.SEEK_END)
                    return True
        except (EOFError, OSError):
            pass
        return False

    def end(self, *, at_once: bool = False) -> None:
        """End it with all workers; ending twice does no harm.

        Args:
            at_once: Kill it, which leaves nothing where it rests.
        """
        if self.control.closed or not self.is_ours:
            return
        if at_once:
            self.process.kill()
        # It kills what is left, removes the scratch folder and ends. Forks of this process are connected too.
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self.control.fileno())) as near:
            near.shutdown(socket.SHUT_RDWR)
        self.control.close()
        try:
            self.process.wait(timeout=_END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._log.close()


_lock = threading.Lock()
_resting: Final[list[NurseryProcess]] = []


def nursery_process() -> NurseryProcess:
    """Return the process that rests, if it fits, or a new one."""
    start, has_folder = _given_at_start(), _working_folder() is not None
    for one in _taken():
        if has_folder and one.fits(start):
            return one
        one.end(at_once=True)
    return NurseryProcess.started()


def let_rest(process: NurseryProcess) -> None:
    """Keep a process for the next campaign, or end it where it cannot be kept.

    Args:
        process: Without workers.
    """
    if process.rest():
        with _lock:
            if not _resting:
                _resting.append(process)
                return
    process.end()


def end_resting() -> None:
    """End the process that rests, if there is one."""
    for one in _taken():
        one.end(at_once=True)


def _taken() -> list[NurseryProcess]:
    with _lock:
        taken = _resting.copy()
        _resting.clear()
        return taken


def _forget() -> None:
    """In a fork of this process: what rests is not its own, and another thread may have held the lock."""
    global _lock
    _lock = threading.Lock()
    _resting.clear()


atexit.register(end_resting)
os.register_at_fork(after_in_child=_forget)


def _command(descriptor: int) -> list[str]:
    places = [place or str(Path.cwd()) for place in sys.path]
    return [sys.executable, "-P", "-c", _BOOTSTRAP, str(descriptor), *places]


def _environment() -> dict[str, str]:
    return dict.fromkeys(_THREADS, "1") | as_for_fmus(os.environ)


def _working_folder() -> str | None:
    with contextlib.suppress(OSError):
        return str(Path.cwd())
    return None


def _given_at_start() -> object:
    """Return what a process is given when it starts, and keeps."""
    variables = {name: value for name, value in os.environ.items() if name.startswith(_READ_AT_START)}
    limits = [
        resource.getrlimit(getattr(resource, name)) for name in dir(resource) if name.startswith("RLIMIT_")
    ]
    status = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    umask = [line for line in status if line.startswith("Umask:")]
    return _command(0), variables, limits, umask, os.sched_getaffinity(0), os.getpriority(os.PRIO_PROCESS, 0)
