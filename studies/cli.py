"""The command line `studies`: its words, its help, its exit codes.

Neither this module nor those in `studies.commands` import anything heavy at their top: help answers at once.
"""

import argparse
import importlib
import io
import os
import shlex
import sys
import textwrap
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from itertools import groupby
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn, TextIO

from simulation.errors import InputError, MachineError
from simulation.foreign_text import escaped, shortened
from simulation.pool.safe_start import start_safely
from studies.commands import options
from studies.console import Console
from studies.environment import check_surroundings, explain
from studies.interrupts import interrupt_heeded, interrupts_kept, is_interrupt
from studies.storage_url import hide_passwords

OK, FAILED, BAD_INPUT, INTERRUPTED, UNHEARD = 0, 1, 2, 130, 141
MOST_SAID = 2000
"""Characters of the line of an error: what it quotes may be a stranger's."""
WIDEST = 110  # columns of help
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
    "report",
    "status",
    "best",
    "ui",
    "reproduce",
    "reproduce-paper",
)

DESCRIPTION = """\
Calibrate a simulation model (an FMU) with a PELS-VAE surrogate.

A study combines a case and a profile. The case declares the FMU, the parameters with their bounds, the
inputs, the measurement and the window. The profile sets the budget and the search space. `studies run` does
all stages in order:

  check         test the case and the speed of a simulation
  simulate      training, validation and test simulations
  sensitivity   Sobol indices per time step
  tune          Optuna chooses latent dimension, hidden width and beta of a PELS-VAE, one study per
                training-set size; each trial is an MLflow run that shows its curves during training
  calibrate     screen the box on the surrogate, polish on the FMU
  report        tables and figures on one page

`studies calibrate` alone needs no surrogate and the fewest simulations. After both, `studies uncertainty`
shows how sure the calibration is.
"""
EPILOG = """\
examples:
  studies new Room.fmu                     a case file for your own FMU; then check, then calibrate
  studies calibrate                        the office, in fewest FMU calls, without a surrogate
  studies run                              the office with surrogates, quick profile: minutes on two cores
  studies run office-recorded --window 8-16
  studies check office                     what is wrong with a case, and what to do
  studies tune --n-train 64 --trials 40    more trials for one size; finished trials are kept
  studies calibrate --n-train 64 --json    one calibration from the stored surrogate
  studies status --live                    running trials, progress, time to go
  studies ui                               compare the runs in MLflow

The project is the nearest folder with a file studies.toml, from the working folder upwards. Without such a
file it is the working folder, and the first command that writes makes the file.

files of the project (label = <case>-<profile>):
  data/<case>/generated/    simulations          mlruns/reports/<label>/index.html    the report
  mlruns/results/<label>/   numbers              mlruns/artifacts/                    weights, pictures
  mlruns/mlflow.db          MLflow (studies ui)  mlruns/optuna.db                     Optuna

Finished work is not repeated. Interrupt any command, type it again, and it goes on.

exit codes:
  0    success
  1    a check or a stage failed, or the machine did (disk, memory)
  2    the input is wrong
  130  interrupted
  141  the reader of the output closed it
"""


class _UsageError(Exception):
    """The command line cannot be understood."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{' '.join(message.split())} (`{self.prog} --help` explains)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    if argv is None:
        start_safely()
    arguments = list(sys.argv[1:] if argv is None else argv)
    _make_writable()
    console = Console(as_json="--json" in arguments)
    try:
        chosen = _understand(arguments)
    except _UsageError as error:
        return _bad_input(console, str(error))
    except SystemExit as done:
        return int(done.code or 0)
    console = Console(as_json=chosen.json, quiet=chosen.quiet)
    with interrupts_kept():
        try:
            check_surroundings(arguments)
            if argv is None:
                from studies.command_folder import give_temporary_folder

                give_temporary_folder()
            answer: int = command_module(chosen.command).run(chosen, console)
            return answer
        except (Exception, KeyboardInterrupt) as error:
            if is_interrupt(error):
                return _interrupted(console, arguments)
            try:
                return _report(console, error)
            except OSError:
                # The report cannot be written either.
                return FAILED


def _make_writable() -> None:
    """Make standard output and error writable, also if they are closed or cannot encode a character."""
    sys.stdout, sys.stderr = sys.stdout or _nowhere(), sys.stderr or _nowhere()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")


def _nowhere() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8", errors="replace")


def _report(console: Console, error: BaseException) -> int:
    """Report the error that ended a command, and return its exit code."""
    if isinstance(error, InputError) and not isinstance(error, MachineError):
        return _bad_input(console, " ".join(str(error).split()))
    if isinstance(error, BrokenPipeError):
        # The reader of the output closed it: nothing has failed, and nothing can be reported.
        sys.stdout = None
        return UNHEARD
    return _failed(console, error)


def _understand(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; an error names the help that explains it.

    Raises:
        _UsageError: there is no such command or option, or a value is wrong.
    """
    first = next((word for word in arguments if not word.startswith("-")), "")
    if first and first not in COMMANDS and arguments[0] == first:
        close = get_close_matches(first, COMMANDS, n=1)
        hint = f"did you mean `studies {close[0]}`?" if close else "`studies --help` lists them"
        raise _UsageError(f"there is no command {first!r}; {hint}")
    chosen, unknown = build_parser().parse_known_args(arguments)
    if unknown:
        words = " ".join(unknown)
        raise _UsageError(f"unrecognized arguments: {words} (`studies {chosen.command} --help` explains)")
    return chosen


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = _Parser(
        prog="studies",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=_Paragraphs,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    for name in COMMANDS:
        words = command_module(name)
        command = commands.add_parser(
            name,
            help=words.HELP,
            description=f"{words.HELP[0].upper()}{words.HELP[1:]}.",
            epilog=words.MORE,
            formatter_class=_Paragraphs,
            allow_abbrev=False,
        )
        words.add_options(command)
        options.add_storage(command)
        options.add_output(command)
    return parser


def command_module(name: str) -> ModuleType:
    """Return the module behind a command: its HELP, MORE, `add_options` and `run`."""
    return importlib.import_module(f"studies.commands.{name.replace('-', '_')}")


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


class _Version(argparse.Action):
    def __init__(self, option_strings: Sequence[str], dest: str, **settings: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **settings)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import PackageNotFoundError, version

        try:
            found = version("pelsvae-studies")
        except PackageNotFoundError:
            found = "(not installed)"
        print(f"studies {found}")
        parser.exit()


def _bad_input(console: Console, line: str) -> int:
    line = shortened(hide_passwords(line), MOST_SAID)
    console.warn(f"error: {line}")
    console.document({"error": line})
    return BAD_INPUT


def _interrupted(console: Console, arguments: Sequence[str]) -> int:
    interrupt_heeded()
    again = hide_passwords(shlex.join(["studies", *arguments]))
    console.warn(f"interrupted; finished work is kept, go on with: {again}")
    console.document({"error": "interrupted", "go_on_with": again})
    return INTERRUPTED


def _failed(console: Console, error: BaseException) -> int:
    """Report a failed stage in one line; an unforeseen error also prints its traceback."""
    from studies.stages.pipeline import StageError

    explained = explain(error)
    if explained is None and not isinstance(error, StageError | MachineError):
        text = hide_passwords("".join(traceback.format_exception(error)))
        sys.stderr.write(escaped(text, keep_lines=True))
    line = hide_passwords(explained or " ".join(f"{error}".split()) or type(error).__name__)
    line = shortened(line, MOST_SAID)
    console.warn(f"error: {line}")
    console.document({"error": line})
    return FAILED
