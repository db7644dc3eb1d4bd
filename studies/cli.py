"""The command line `studies`: its words, its help, its exit codes.

Neither this module nor those in `studies.commands` import anything heavy at their top: help answers at once.
"""

import argparse
import errno
import gc
import importlib
import io
import os
import shlex
import sys
import textwrap
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path
from types import ModuleType
from typing import NoReturn, TextIO

import studies.commands
from simulation.errors import InputError, MachineError
from simulation.foreign_text import escaped, shortened
from simulation.pool.safe_start import start_safely
from studies.commands import options
from studies.words.console import Console
from studies.words.quiet_loggers import working

OK, FAILED, BAD_INPUT, INTERRUPTED, UNHEARD = 0, 1, 2, 130, 141
MOST_SAID = 2000
"""Characters of the line of an error: what it quotes may be a stranger's."""
WIDEST = 110  # columns of help
DESCRIPTION, EXAMPLES, EPILOG = str(studies.commands.__doc__).partition("\nExamples:\n")
EPILOG = f"{EXAMPLES.lstrip()}{EPILOG}"
COMMANDS = (
    "new",
    "import-recording",
    "check",
    "run",
    "simulate",
    "sensitivity",
    "tune",
    "calibrate",
    "uncertainty",
    "choose",
    "next",
    "predict",
    "report",
    "status",
    "best",
    "compare",
    "ui",
    "reproduce",
    "reproduce-paper",
)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{' '.join(message.split())} (`{self.prog} --help` explains)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    if argv is None:
        start_safely()
        os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    arguments = list(sys.argv[1:] if argv is None else argv)
    _make_writable()
    console = Console(as_json="--json" in arguments)
    try:
        chosen = _understand(arguments)
        console = Console(as_json=chosen.json, quiet=chosen.quiet)
        check_surroundings()
        if argv is None:
            from studies.command_folder import give_temporary_folder

            give_temporary_folder()
            if chosen.command in ("status", "best"):
                gc.disable()  # they read, show and end: what they read stays
        with working():
            return int(command_module(chosen.command).run(chosen, console))
    except SystemExit as done:  # help, version
        return int(done.code or 0)
    except (Exception, KeyboardInterrupt) as error:
        if is_interrupt(error):
            return _interrupted(console, shlex.join(["studies", *arguments]))
        try:
            return _report(console, error)
        except OSError:
            # The report cannot be written either.
            return FAILED


def is_interrupt(error: BaseException | None) -> bool:
    """Say whether an error is a Ctrl-C, or was raised while one was on its way."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _make_writable() -> None:
    """Make standard output and error writable, also if they are closed or cannot encode a character."""
    sys.stdout, sys.stderr = sys.stdout or _nowhere(), sys.stderr or _nowhere()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")


def _nowhere() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8", errors="replace")


def _report(console: Console, error: BaseException) -> int:
    """Report the error that ended a command in one line; an unforeseen one also prints its traceback.

    Returns:
        The exit code.
    """
    if isinstance(error, InputError) and not isinstance(error, MachineError):
        return _ended(console, " ".join(str(error).split()), BAD_INPUT)
    if isinstance(error, BrokenPipeError):
        # The reader of the output closed it: nothing has failed, and nothing can be reported.
        sys.stdout = None
        return UNHEARD
    from studies.task import StageError

    explained = explain(error)
    if explained is None and not isinstance(error, StageError | MachineError):
        sys.stderr.write(escaped("".join(traceback.format_exception(error)), keep_lines=True))
    return _ended(console, explained or " ".join(f"{error}".split()) or type(error).__name__, FAILED)


def _understand(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; an error names the help that explains it.

    Raises:
        InputError: there is no such command or option, or a value is wrong.
    """
    if arguments and not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
        close = get_close_matches(arguments[0], COMMANDS, n=1)
        hint = f"did you mean `studies {close[0]}`?" if close else "`studies --help` lists them"
        raise InputError(f"there is no command {arguments[0]!r}; {hint}")
    chosen, unknown = build_parser().parse_known_args(arguments)
    if unknown:
        words = " ".join(unknown)
        raise InputError(f"unrecognized arguments: {words} (`studies {chosen.command} --help` explains)")
    return chosen


@cache
def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = _Parser(
        prog="studies",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=_Paragraphs,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=_version(), help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    for name in COMMANDS:
        summary, more = help_of(name)
        command = commands.add_parser(
            name,
            help=f"{summary[0].lower()}{summary[1:].rstrip('.')}",
            description=summary,
            epilog=more,
            formatter_class=_Paragraphs,
            allow_abbrev=False,
        )
        for option in (*command_module(name).OPTIONS, *options.EVERYWHERE):
            command.add_argument(*option.names, **option.how)
    return parser


def command_module(name: str) -> ModuleType:
    """Return the module behind a command: its help as docstring, `OPTIONS` and `run`."""
    return importlib.import_module(f"studies.commands.{name.replace('-', '_')}")


def help_of(name: str) -> tuple[str, str]:
    """Return what a command does in a sentence, and the rest of its help."""
    summary, _, more = str(command_module(name).__doc__).partition("\n\n")
    return summary, more


class _Paragraphs(argparse.HelpFormatter):
    """Fills paragraphs to the terminal's width; lines that are indented, the examples, stay as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        filled: list[str] = []
        for is_kept, lines in groupby(text.splitlines(), key=lambda line: not line or line.startswith(" ")):
            if is_kept:
                filled += lines
            else:
                words = " ".join(lines)
                filled += textwrap.wrap(
                    words, min(width, WIDEST), break_long_words=False, break_on_hyphens=False
                )
        return "\n".join(filled)


def _version() -> str:
    try:
        return f"studies {version('pelsvae-studies')}"
    except PackageNotFoundError:
        return "studies (not installed)"


def _ended(console: Console, line: str, code: int) -> int:
    """Say in one line what ended a command, and return its exit code."""
    line = shortened(line, MOST_SAID)
    console.warn(f"error: {line}")
    console.document({"error": line})
    return code


def _interrupted(console: Console, again: str) -> int:
    console.warn(f"interrupted; finished work is kept, go on with: {again}")
    console.document({"error": "interrupted", "go_on_with": again})
    return INTERRUPTED


_REMEDIES = {
    errno.EACCES: "allow reading and writing there",
    errno.EPERM: "allow reading and writing there",
    errno.EROFS: "allow reading and writing there",
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EFBIG: "allow larger files (ulimit -f)",
    errno.ENOTDIR: "move away the file that stands where a folder should be",
    errno.EISDIR: "move away the folder that stands where a file should be",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "raise the limit of open files (ulimit -n)",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ELOOP: "remove the link that leads back to itself",
}


def check_surroundings() -> None:
    """Refuse to begin where every command would fail somewhere deep inside.

    Raises:
        MachineError: the working folder was deleted, names of files are not read as UTF-8, or Linux shows no
            processes.
    """
    try:
        Path.cwd()
    except OSError:
        raise MachineError("the working folder was deleted; go to another folder (cd)") from None
    encoding, words = sys.getfilesystemencoding(), [str(Path.cwd()), *sys.argv]
    if encoding != "utf-8" and not all(word.isascii() for word in words):
        raise MachineError(
            f"this Python takes names of files for {encoding}, and one here has other letters than A to Z; "
            "set LC_ALL=C.UTF-8, or PYTHONUTF8=1"
        )
    if sys.platform == "linux" and not Path("/proc/self").exists():
        raise MachineError(
            "there is no /proc, by which processes are known; mount it: mount -t proc proc /proc"
        )


def explain(error: BaseException) -> str | None:
    """Say in one line what is in the way and the remedy; None where the error is something else."""
    if isinstance(error, MemoryError):
        said = " ".join(str(error).split()) or "the memory is exhausted"
        return f"too little memory: {said}; take fewer samples, longer steps or fewer --jobs"
    if isinstance(error, OSError) and error.errno in _REMEDIES:
        where = f": {error.filename}" if error.filename else ""
        return f"{error.strerror}{where}; {_REMEDIES[error.errno]}, then type the command again"
    return None
