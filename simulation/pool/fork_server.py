"""The process that supervisors are forked from: its imports take a second, and happen once.

It imports modules of this package alone: what a user may change between two models, supervisors import.
"""

import contextlib
import importlib
import os
import signal
import socket
import subprocess
import sys
import threading
import weakref
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from time import monotonic

from simulation.pool.execution import ExecutionPolicy
from simulation.pool.family import adopt_orphans, in_a_fork, kill_descendants
from simulation.pool.safe_start import as_for_fmus
from simulation.pool.supervisor import Job, no_process, supervise
from simulation.pool.worker_process import ROOM, Factory, packed, remember

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment of processes that share the work: threads below that would only get into each other's way."""
_TICK_S = 1.0  # how often ended supervisors are looked for
# Without supervisors it ends after this time.
_PATIENCE_S = 60.0
_ENDING_S = 60.0
# What `python -c` runs, given a descriptor and sys.path.
_BOOTSTRAP = (
    "import sys; sys.path[:] = sys.argv[2:]; "
    "from simulation.pool.fork_server import main; main(int(sys.argv[1]))"
)


class _ForkServer:
    """The fork server as this process sees it: its process, and the connection to it."""

    def __init__(self, places: list[str], environment: dict[str, str]) -> None:
        near, far = socket.socketpair()
        with far:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", _BOOTSTRAP, str(far.fileno()), *places],
                stdin=subprocess.DEVNULL,
                pass_fds=[far.fileno()],
                env=environment,
                # Ctrl-C reaches only the process that decides what it means.
                start_new_session=True,
            )
        self.control = Connection(near.detach())


_lock = threading.Lock()
# By what they were given at their start, and the process that started them: a fork of it has its own.
_servers: dict[tuple[object, ...], _ForkServer] = {}
KNOWN: set[bytes] = set()
"""What workers had to compile, see learnt(), for the next ones."""


def spawn_supervisor(make_model: Factory, policy: ExecutionPolicy) -> Connection:
    """Start a supervisor in surroundings like those of this process.

    Args:
        make_model: The factory of its model.
        policy: What happens to rows that hang, crash or fail.

    Returns:
        The connection to it, see `supervise`; it closes at once where the fork server is killed meanwhile.

    Raises:
        RuntimeError: If no other process could read the factory.
    """
    folder = str(Path.cwd())
    module = getattr(make_model, "__module__", "")
    job = Job(packed(make_model), module, frozenset(KNOWN), policy, folder)
    places = [place or folder for place in sys.path]
    environment = ONE_THREAD | as_for_fmus(os.environ)
    near, far = socket.socketpair()
    with _lock, far:
        key = os.getpid(), (*places,), frozenset(environment.items())
        while True:
            if key not in _servers or _servers[key].process.poll() is not None:
                _servers[key] = _ForkServer(places, environment)
            server = _servers[key]
            try:
                server.control.send(job)
                send_handle(server.control, far.fileno(), server.process.pid)
                break
            except (BrokenPipeError, ConnectionResetError):
                server.process.wait()  # it has just been killed
    return Connection(near.detach())


def hang_up(connection: Connection) -> None:
    """Have the far end of a connection read its end; forks of this process may hold the connection, too.

    Args:
        connection: The connection, which stays open here.
    """
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(connection.fileno())) as near:
        near.shutdown(socket.SHUT_WR)


def end_fork_servers() -> None:
    """End what supervisors are forked from, and wait for those that exist; the next one starts another."""
    with _lock:
        for key in [key for key in _servers if os.getpid() in key]:
            server = _servers.pop(key)
            hang_up(server.control)
            server.process.wait(_ENDING_S)
            server.control.close()


# At exit, after the processes that no one has closed: finalizers run in the reverse order of their making,
# and this one is made before any of theirs. A function of atexit would run before or after all of them.
weakref.finalize(end_fork_servers, end_fork_servers)


def main(descriptor: int) -> None:
    """Be the fork server at the far end of a connection, until that closes or stays idle for long.

    Args:
        descriptor: The connection's file descriptor.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    adopt_orphans()
    os.set_inheritable(descriptor, False)
    control, worked = Connection(descriptor), monotonic()
    supervisors: set[int] = set()
    while supervisors or not (control.closed or monotonic() - worked > _PATIENCE_S):
        if wait([] if control.closed else [control], _TICK_S):
            try:
                supervisors.add(_spawned(control))
            except (EOFError, OSError):
                control.close()
            worked = monotonic()
        ended = {pid for pid in supervisors if os.waitpid(pid, os.WNOHANG)[0]}
        supervisors -= ended
        if ended:
            # One that was killed leaves behind what it should have ended.
            kill_descendants(but=supervisors)
    # Taking modules apart takes half a second.
    os._exit(0)


def _spawned(control: Connection) -> int:
    job: Job = control.recv()
    connection = Connection(recv_handle(control))
    if job.module.partition(".")[0] == ROOM:
        importlib.import_module(job.module)
    for known in job.known:
        remember(known)

    def supervise_alone() -> None:
        control.close()
        supervise(connection, job)

    with connection:
        try:
            return in_a_fork(supervise_alone)
        except OSError as error:
            connection.send(no_process(error))
            raise
