"""Wine, which runs programs for Windows: where it is, its folder, and a worker with a server of its own."""

import contextlib
import logging
import os
import select
import shutil
import signal
import subprocess
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any

from simulation.errors import MachineError
from simulation.file_lock import FileLock

WORKER = Path(__file__).parents[1] / "worker" / "fmu_worker-x86_64-windows.exe"
"""The program that runs one FMU, built of fmu_worker.c beside it."""
INSTALL = "install Wine (Debian, Ubuntu: apt install wine64)"
_LOG = logging.getLogger(__name__)
_DEBIANS = Path("/usr/lib/wine")  # where the package wine64 puts its programs, without a command
_REGISTRY = ("system.reg", "user.reg", "userdef.reg", ".update-timestamp")
_MADE = "made-by-studies"
_MAKING_S = 600.0
_STARTING_S = 120.0
_ENDING_S = 2.0
_PING = b"\x01\x00\x00\x00P"  # who made the worker reads its answer
_PIECE = select.PIPE_BUF  # a pipe that is ready takes so much without waiting


@cache
def wine_program() -> Path | None:
    """Find Wine; None where it is not installed."""
    return _found("wine64", "wine")


def _found(*names: str) -> Path | None:
    for name in names:
        found = shutil.which(name) or shutil.which(name, path=str(_DEBIANS))
        if found:
            return Path(found)
    return None


def wine_folder() -> Path:
    """Return the folder of Wine's files: that of WINEPREFIX, else one in the user's cache."""
    if named := os.environ.get("WINEPREFIX"):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "studies" / "wine"


class WineWorker:
    """The program that runs an FMU for Windows, asked by messages over pipes.

    Its server of Wine is its own, in a folder that borrows the files of `wine_folder`: what an FMU does to
    Wine reaches no other worker, and all that Wine starts ends with it.
    """

    def __init__(self, folder: Path) -> None:
        """Start it.

        Args:
            folder: Its working folder, where the FMU is unpacked.

        Raises:
            MachineError: If there is no Wine, or it does not start.
        """
        program, server = wine_program(), _found("wineserver64", "wineserver")
        if program is None or server is None:
            raise MachineError(f"Wine is not installed; {INSTALL}")
        make_wine_folder(_LOG.warning)
        self._server = server
        try:
            self._environment = _environment(_borrowed(wine_folder(), folder / "wine"))
            # It comes back when the server is ready, and this one when the server has ended.
            subprocess.run([server], check=True, timeout=_STARTING_S, **self._surroundings)
            self._watch = subprocess.Popen([server, "-w"], **self._surroundings)
            self._process = subprocess.Popen(
                [program, WORKER],
                bufsize=0,
                stdout=subprocess.PIPE,
                cwd=folder,
                **self._surroundings | {"stdin": subprocess.PIPE},
            )
        except (OSError, subprocess.SubprocessError) as error:
            remedy = f"remove {wine_folder()}, which is made anew, or install Wine again"
            if os.environ.get("WINEPREFIX"):
                remedy = f"WINEPREFIX={wine_folder()} has to be a folder that `wineboot` has made"
            raise MachineError(f"Wine ({program}) does not start ({error}); {remedy}") from None
        self._check_started(program)

    def _check_started(self, program: Path) -> None:
        """Wait until Wine has started, which is not the FMU's doing, and never takes long."""
        assert self._process.stdout is not None
        began, how = monotonic(), "ended before it had started"
        with contextlib.suppress(OSError):
            self.send(_PING)
            if self._is_ready(self._process.stdout.fileno(), select.POLLIN, _STARTING_S):
                return
            if monotonic() - began > _STARTING_S:
                how = f"did not start within {_STARTING_S:g} s"
        self.close()
        raise MachineError(f"Wine ({program}) {how}; try again")

    @property
    def _surroundings(self) -> dict[str, Any]:
        # Ctrl-C reaches only the process that decides what it means.
        return {"env": self._environment, "stdin": subprocess.DEVNULL, "start_new_session": True}

    def send(self, content: bytes) -> None:
        """Send it something.

        Raises:
            OSError: If it has ended, or its server has.
        """
        assert self._process.stdin is not None
        pipe = self._process.stdin.fileno()
        os.set_blocking(pipe, False)
        while content:
            if not self._is_ready(pipe, select.POLLOUT):
                raise BrokenPipeError
            content = content[os.write(pipe, content[:_PIECE]) :]

    def read(self, n: int) -> bytes:
        """Read what it sends; fewer bytes where it has ended, or its server has.

        Args:
            n: How many bytes.
        """
        assert self._process.stdout is not None
        pipe, parts = self._process.stdout.fileno(), list[bytes]()
        while n and self._is_ready(pipe, select.POLLIN):
            part = os.read(pipe, n)
            if not part:
                break
            parts.append(part)
            n -= len(part)
        return b"".join(parts)

    def _is_ready(self, pipe: int, event: int, limit_s: float | None = None) -> bool:
        """Wait for a pipe; return False where the worker or its server has ended.

        Without its server a process of Wine waits for ever; without the worker, other processes of Wine may
        still have its pipes.
        """
        ends, poll = [os.pidfd_open(one.pid) for one in (self._process, self._watch)], select.poll()
        try:
            poll.register(pipe, event)
            for end in ends:
                poll.register(end, select.POLLIN)
            return any(one == pipe for one, _ in poll.poll(limit_s and 1000 * limit_s))
        finally:
            for end in ends:
                os.close(end)

    def exit_code(self) -> int:
        """Return what it has ended with, or minus the signal that killed it or its server."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(_ENDING_S)
        return -signal.SIGKILL

    def close(self, last_message: bytes = b"") -> None:
        """End it with all that Wine started for it; closing twice does no harm.

        Args:
            last_message: After which it ends by itself.
        """
        if self._process.poll() is None and last_message:
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):
                self.send(last_message)
                self._process.wait(_ENDING_S)
        # Not only where it is watched still: who watches may have been killed instead.
        with contextlib.suppress(subprocess.TimeoutExpired):
            subprocess.run([self._server, "-k"], check=False, timeout=_STARTING_S, **self._surroundings)
        for process in (self._process, self._watch):
            process.kill()
            process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


def _environment(folder: Path) -> dict[str, str]:
    """Return the environment of a process of Wine: silent, without windows, menus and debugger."""
    without = "mscoree=;mshtml=;winemenubuilder.exe=;winedbg.exe="
    changed = {
        "WINEPREFIX": str(folder),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": without,
        "WINEARCH": "win64",
    }
    # What the server keeps in the temporary folder goes with it.
    changed["TMPDIR"] = str(folder)
    return {name: value for name, value in os.environ.items() if name != "DISPLAY"} | changed


def _borrowed(lender: Path, folder: Path) -> Path:
    """Make a folder of Wine with a registry of its own and the files of another one."""
    drives = folder / "dosdevices"
    drives.mkdir(parents=True)
    (folder / "drive_c").symlink_to(lender / "drive_c")
    (drives / "c:").symlink_to("../drive_c")
    (drives / "z:").symlink_to("/")
    for name in _REGISTRY:
        shutil.copyfile(lender / name, folder / name)
    return folder


def make_wine_folder(on_warning: Callable[[str], None]) -> None:
    """Make Wine's folder where it is not there, or of another Wine; a user's own is left as it is.

    Args:
        on_warning: Called with one line before it is made.

    Raises:
        MachineError: If it cannot be made.
    """
    folder, program = wine_folder(), wine_program()
    if program is None or os.environ.get("WINEPREFIX"):
        return
    # Wine would bring one of an older version up to date at each start of each worker.
    made, by = folder / _MADE, f"{program} of {program.stat().st_mtime_ns}"

    def is_made() -> bool:
        return made.is_file() and made.read_text("utf-8") == by

    if is_made():
        return
    lock = FileLock(folder.with_name(f"{folder.name}.lock"))
    try:
        lock.acquire()
        if not is_made():
            on_warning(f"Wine needs a folder of 700 MB, which is made once, in some 20 s: {folder}")
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            _run([program, "wineboot", "-i"], folder)
            _run([_found("wineserver64", "wineserver") or program, "-w"], folder)
            made.write_text(by, "utf-8")
    except (OSError, subprocess.SubprocessError) as error:
        raise MachineError(f"Wine cannot make its folder {folder} ({error}); make room there") from None
    finally:
        if lock.is_held:
            lock.release()


def _run(command: Sequence[str | Path], folder: Path) -> None:
    subprocess.run(
        command,
        env=_environment(folder),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=_MAKING_S,
        start_new_session=True,
        check=True,
    )
