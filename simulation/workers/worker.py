"""What runs in worker processes: a nursery that has imported everything, and its children that simulate.

The nursery never loads a model. Each worker is a fork of it, so that replacing one that crashed, hung or grew
costs what opening the model costs, and not a second of imports. Both end with the process they work for.
"""

import contextlib
import os
import pickle
import select
import shutil
import signal
import site
import sys
import sysconfig
import tempfile
import threading
import traceback
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import recv_handle
from pathlib import Path
from typing import Any, Final

from simulation.errors import InputError, MachineError
from simulation.foreign_code import opening_limited
from simulation.scratch import ScratchFolder
from simulation.workers.family import adopt_orphans, kill_descendants
from simulation.workers.memory_watch import OutOfMemoryWatch
from simulation.workers.messages import (
    Ended,
    Hire,
    Hired,
    Learnt,
    Limits,
    Opened,
    Ready,
    Refused,
    Rest,
    Rested,
    Task,
)
from simulation.workers.recipe import Facts, Recipe
from simulation.workers.row_desk import RowDesk
from simulation.workers.warm_code import learnt, remember

SCRATCH_PREFIX: Final = "simulation-workers-"
_LAST_LINE_BYTES: Final = 4096
_LAST_LINE_CHARACTERS: Final = 300


def main(descriptor: int) -> None:
    """Be the nursery at the far end of a connection, until it closes or nobody has a task for long.

    Args:
        descriptor: The connection's file descriptor.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    adopt_orphans()
    control = Connection(descriptor)
    os.set_inheritable(descriptor, False)
    with contextlib.suppress(EOFError, OSError):  # nobody is there any more
        task = control.recv()
        while (rest := _done(task, control)) is not None and _is_as_installed():
            # Rested, it stands in nobody's way.
            os.chdir("/")
            control.send(Rested())
            if not control.poll(rest.patience_s):
                break
            task = control.recv()
    # Somebody waits, and taking modules apart takes half a second.
    os._exit(0)


def _done(task: Task, control: Connection) -> Rest | None:
    """Do a task; return what follows, None for the end."""
    try:
        os.environ.clear()
        os.environ.update(task.environment)
        tempfile.tempdir = None
        if task.folder is not None:
            os.chdir(task.folder)
        make_model: Recipe = pickle.loads(task.recipe)
        nursery = _Nursery(control, make_model, task.limits)
    except Exception as error:
        control.send(_refusal(error))
        return None
    control.send(Ready())
    return nursery.run()


def _is_as_installed() -> bool:
    """Tell whether all that is loaded belongs to this package or was installed.

    Other files may change between two tasks; a new process reads them again.
    """
    installed = {*sysconfig.get_paths().values(), *site.getsitepackages(), site.getusersitepackages()}
    places = tuple(f"{place}{os.sep}" for place in installed)
    room = __name__.partition(".")[0]
    files = (
        getattr(module, "__file__", None)
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] != room
    )
    return all(file is None or file.startswith(places) for file in files)


class _Nursery:
    def __init__(self, control: Connection, make_model: Recipe, limits: Limits) -> None:
        self._control = control
        self._make_model = make_model
        self._limits = limits
        self._workers: dict[int, int] = {}
        self._memory = OutOfMemoryWatch()
        self._scratch = ScratchFolder(SCRATCH_PREFIX)
        self._pipe = self._wake, wake = os.pipe()
        for end in self._pipe:
            os.set_blocking(end, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)

    def run(self) -> Rest | None:
        """Serve; return what shall follow, None where nobody is left to serve."""
        try:
            while True:
                ready = wait([self._control, self._wake])
                if self._wake in ready:
                    with contextlib.suppress(BlockingIOError):
                        os.read(self._wake, 4096)
                    self._reap()
                if self._control in ready:
                    order = self._control.recv()
                    if isinstance(order, Rest):
                        return order
                    if isinstance(order, Hire):
                        self._hire(order.worker)
                    elif isinstance(order, Learnt):
                        remember(order.known)
                    elif order.worker in self._workers:
                        _kill(self._workers[order.worker])
        except (EOFError, OSError):
            return None  # the process that all this works for is gone, or done
        finally:
            for pid in self._workers.values():
                _kill(pid)
            for pid in self._workers.values():
                os.waitpid(pid, 0)
            kill_descendants(os.getpid())
            self._scratch.remove()
            signal.set_wakeup_fd(-1)
            for end in self._pipe:
                os.close(end)

    def _hire(self, worker: int) -> None:
        descriptor = recv_handle(self._control)
        os.set_inheritable(descriptor, False)
        folder = self._folder(worker)
        try:
            folder.mkdir()
            pid = os.fork()
        except OSError as error:
            # The others go on, and it is tried again later; where there are none, fewer would not help.
            one, lower = ("one more", "lower simulation.max_workers, or ") if self._workers else ("a", "")
            why = (
                f"{one} process for simulations cannot be started ({error.strerror}); {lower}"
                f"free memory, processes or room in {tempfile.gettempdir()}"
            )
            shutil.rmtree(folder, ignore_errors=True)
            with Connection(descriptor) as connection:
                connection.send(Refused(why, MachineError))
            self._control.send(Ended(worker, None))
            return
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            self._control.close()
            code = 70
            try:
                os.setsid()
                code = _work(Connection(descriptor), self._make_model, folder, self._limits)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        os.close(descriptor)
        self._workers[worker] = pid
        self._control.send(Hired(worker, pid))

    def _reap(self) -> None:
        for worker, pid in list(self._workers.items()):
            if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
                continue
            # Before its number can be given to another: what it started goes with it.
            _kill(pid)
            exit_code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            del self._workers[worker]
            kill_descendants(os.getpid(), but=frozenset(self._workers.values()))
            folder = self._folder(worker)
            last_line = _last_line(folder / "log")
            shutil.rmtree(folder, ignore_errors=True)
            has_struck = self._memory.has_struck()
            out_of_memory = exit_code == -signal.SIGKILL and has_struck
            self._control.send(Ended(worker, exit_code, last_line, out_of_memory))

    def _folder(self, worker: int) -> Path:
        return self._scratch.folder / f"{worker:05d}"


def _work(connection: Connection, make_model: Recipe, folder: Path, limits: Limits) -> int:
    """Be a worker: open the model, then run what comes; return the exit code."""
    adopt_orphans()
    _end_with(connection)
    _settle(folder)
    try:
        with opening_limited(limits.opening_s):
            model = make_model()
        facts = Facts(model.parameter_space, model.output_names, model.time)
    except Exception as error:
        connection.send(_refusal(error))
        return 0
    # Files that an FMU leaves in its working directory go with the worker.
    os.chdir(folder)
    connection.send(Opened(facts))
    told = learnt()
    connection.send(Learnt(told))
    desk = RowDesk(model, max_growth_mb=limits.max_growth_mb, max_rows=limits.max_rows, log=folder / "log")
    while (run := connection.recv()) is not None:
        ran = desk.work_off(run)
        connection.send(ran)
        if told and (now := learnt()) != told:
            connection.send(Learnt(now))
        told = b""
        if ran.wants_rest:
            break
    close: Any = getattr(model, "close", None)
    if close is not None:
        close()
    return 0


def _end_with(connection: Connection) -> None:
    """End this process and all that it started when the far end of the connection closes."""
    far_end, parent = select.poll(), os.getppid()
    far_end.register(connection.fileno(), 0)

    def watch() -> None:
        # A fork of the process that we work for may hold the far end open: its child notices.
        while not far_end.poll(1000) and os.getppid() == parent:
            pass
        kill_descendants(os.getpid())
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, name="end-with-connection", daemon=True).start()


def _settle(folder: Path) -> None:
    """Give this process its own temporary folder and its own log instead of a terminal."""
    log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(nothing)
    os.close(log)
    os.environ["TMPDIR"] = str(folder)
    tempfile.tempdir = None
    # When memory ends, the system shall stop this process and not the one that keeps the results.
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")


def _refusal(error: Exception) -> Refused:
    if isinstance(error, InputError):
        return Refused(str(error), MachineError if isinstance(error, MachineError) else InputError)
    return Refused("".join(traceback.format_exception(error)), RuntimeError)


def _kill(pid: int) -> None:
    """Kill a worker and the processes that it started."""
    for kill in (os.killpg, os.kill):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            kill(pid, signal.SIGKILL)


def _last_line(log: Path) -> str:
    try:
        with log.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _LAST_LINE_BYTES))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    said = [" ".join(line.split()) for line in lines if line.strip()]
    return said[-1][:_LAST_LINE_CHARACTERS] if said else ""
