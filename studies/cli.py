"""The command line `studies`: its words, its help, its exit codes. Imports nothing heavy."""

import argparse
import shlex
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from simulation.errors import InputError
from studies import cli_help, cli_values
from studies.console import Console

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
SIMULATING = ("simulate", "sensitivity", "tune", "calibrate", "run")

DESCRIPTION = """\
Calibrate a simulation model (an FMU) with a PELS-VAE surrogate.

A study is a case x a profile: the case says what is calibrated (FMU, parameters with bounds, inputs,
measurement, window), the profile how much may be spent on it. `studies run` does everything in order:

  check         the doctor: is the case sound, how long does a simulation take
  simulate      training, validation and test simulations
  sensitivity   Sobol indices per time step
  tune          one Optuna study per training-set size, every trial an MLflow run
  calibrate     screen the box on the surrogate, polish on the FMU; or neither: calibrate --method adaptive
  report        tables and figures on one page
"""
EPILOG = """\
examples:
  studies new Room.fmu                     a case file for an FMU of your own; then check, then run
  studies run                              the office, quick profile: minutes on two cores
  studies run office-recorded --window 8-16
  studies check fmus/office/case.toml      what is wrong with a case, and what to do
  studies tune --n-train 64 --trials 20    more trials for one size; finished ones are kept
  studies calibrate --n-train 64 --json    one calibration from the stored surrogate
  studies calibrate --method adaptive      no training set: right after check
  studies ui                               compare the runs in MLflow

where results land (label = <case>-<profile>):
  data/<case>/generated/    simulations          mlruns/reports/<label>/index.html    the report
  mlruns/results/<label>/   numbers              mlruns/champions/<label>/            best surrogates
  mlruns/mlflow.db          MLflow (studies ui)  mlruns/optuna.journal                Optuna

Finished work is never done twice: interrupt any command, type it again, and it goes on.
Exit codes: 0 good, 1 a check or a stage failed, 2 the input is wrong, 130 interrupted.
"""


class _UsageError(Exception):
    """The command line cannot be understood."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{' '.join(message.split())} (`{self.prog} --help` explains)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    console = Console(as_json="--json" in arguments)
    try:
        options = build_parser().parse_args(arguments)
    except _UsageError as error:
        return _bad_input(console, str(error))
    except SystemExit as done:
        return int(done.code or 0)
    console = Console(as_json=options.json, quiet=options.quiet)
    try:
        from studies.cli_commands import COMMANDS

        return COMMANDS[options.command](options, console)
    except InputError as error:
        return _bad_input(console, " ".join(str(error).split()))
    except KeyboardInterrupt:
        again = shlex.join(["studies", *arguments])
        console.warn(f"interrupted; what is finished is kept, go on with: {again}")
        console.document({"error": "interrupted", "go_on_with": again})
        return INTERRUPTED
    except BrokenPipeError:
        # whoever read our output has left; there is nobody to tell
        sys.stdout = None
        return FAILED
    except Exception as error:
        return _failed(console, error)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = _Parser(
        prog="studies",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    def add(name: str, help_line: str, more: str, *, with_case: bool = True) -> argparse.ArgumentParser:
        command = commands.add_parser(
            name,
            help=help_line,
            description=f"{help_line[0].upper()}{help_line[1:]}.",
            epilog=more,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        if with_case:
            _add_case_options(command)
        if name in SIMULATING:
            _add_simulation_options(command)
        _add_output_options(command)
        return command

    _add_new_options(
        add("new", "write a case file from what an FMU says about itself", cli_help.NEW, with_case=False)
    )
    check = add("check", "examine a case and say what is wrong and what to do", cli_help.CHECK)
    check.add_argument(
        "--thorough", action="store_true", help="do every examination, however long the simulations take"
    )
    add("simulate", "simulate the training, validation and test sets", cli_help.SIMULATE)
    add("sensitivity", "estimate first- and total-order Sobol indices per time step", cli_help.SENSITIVITY)
    _add_tuning_options(add("tune", "tune one surrogate per training-set size", cli_help.TUNE))
    calibrate = add("calibrate", "find the parameters that fit best", cli_help.CALIBRATE)
    _add_method_options(calibrate)
    _add_sizes(calibrate, "sizes to calibrate with; default: all that have a surrogate")
    _add_calibration_options(calibrate)
    add("report", "put tables and figures of all results on one page", cli_help.REPORT)
    ui = add("ui", "open MLflow's user interface on this project's runs", cli_help.UI, with_case=False)
    ui.add_argument(
        "--port",
        type=cli_values.port,
        metavar="N",
        help="port on 127.0.0.1; default: 5000 or the next free one",
    )
    ui.add_argument("--dry-run", action="store_true", help="print what would be started and stop there")
    recording = add(
        "import-recording",
        "check a published recording and store it as a case's CSV",
        cli_help.IMPORT,
        with_case=False,
    )
    recording.add_argument(
        "files", nargs="+", metavar="FILE", help="a .mat, the FMU that holds it, CSV files, a folder"
    )
    run = add("run", "do everything in order, skipping what is finished", cli_help.RUN)
    _add_tuning_options(run)
    _add_calibration_options(run)
    return parser


def _add_case_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "case",
        nargs="?",
        default="office",
        metavar="CASE",
        help="name, file or folder of a case; default: office",
    )
    command.add_argument(
        "--profile", default="quick", metavar="NAME", help="budget: quick (default), paper, or a profile file"
    )
    command.add_argument(
        "--window",
        type=cli_values.window,
        metavar="A-B",
        help="days of the recording, e.g. 8-16, or with a unit: 0-10s, 2-8h; default: the case's own",
    )
    command.add_argument(
        "--seed",
        type=cli_values.whole(0, 2**32 - 1),
        metavar="N",
        help="seed of every draw; default: the profile's",
    )
    command.add_argument(
        "--jobs", type=cli_values.whole(1), metavar="N", help="processes; default: as many as there are cores"
    )


def _add_simulation_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--retry-failed", action="store_true", help="ask simulations again that failed before"
    )
    command.add_argument(
        "--dask",
        type=cli_values.address,
        metavar="ADDRESS",
        help="simulate on a Dask cluster, e.g. tcp://scheduler:8786; default: processes of this machine",
    )


def _add_new_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("fmu", metavar="FMU", help="an .fmu file, FMI 2.0 or 3.0")
    command.add_argument("--to", metavar="FOLDER", help="the case's folder; default: fmus/<name of the FMU>")
    command.add_argument(
        "--output", nargs="+", action="extend", metavar="NAME", help="measured outputs; default: the first"
    )
    command.add_argument(
        "--parameter",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="parameters to calibrate, names or patterns like 'wall.*'; default: those at the top level",
    )
    command.add_argument(
        "--interface",
        choices=("co-simulation", "model-exchange"),
        help="how the FMU is run; default: co-simulation where the FMU offers it",
    )
    command.add_argument("--all", action="store_true", help="write every variable, however many there are")
    command.add_argument("--list", action="store_true", help="show the FMU's variables and write nothing")


def _add_output_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--json", action="store_true", help="one JSON document on stdout, everything else on stderr"
    )
    command.add_argument("-q", "--quiet", action="store_true", help="only results and errors")


def _add_sizes(command: argparse.ArgumentParser, help_line: str) -> None:
    command.add_argument("--n-train", nargs="+", type=cli_values.whole(4), metavar="N", help=help_line)


def _add_tuning_options(command: argparse.ArgumentParser) -> None:
    _add_sizes(command, "training-set sizes; default: the profile's")
    command.add_argument(
        "--trials",
        type=cli_values.whole(1),
        metavar="N",
        help="trials per size in total; default: the profile's",
    )


def _add_method_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--method",
        choices=("paper", "adaptive"),
        default="paper",
        help="paper (default): screen on the surrogate, polish; adaptive: fewest FMU calls, no training set",
    )
    command.add_argument(
        "--parallel",
        type=cli_values.whole(1, 64),
        metavar="Q",
        help="adaptive: simulations side by side; default: 1",
    )


def _add_calibration_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--max-calls",
        type=cli_values.whole(1),
        metavar="N",
        help="most FMU calls of one polish; default: the profile's (adaptive: of all, default 100)",
    )
    target_help = "also say how many calls reached this error (adaptive: go on until there)"
    command.add_argument("--target", type=cli_values.positive, metavar="MSE", help=target_help)
    command.add_argument("--again", action="store_true", help="calibrate once more though it is finished")


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
    console.warn(f"error: {line}")
    console.document({"error": line})
    return BAD_INPUT


def _failed(console: Console, error: Exception) -> int:
    """Say that a stage failed in one line; anything unforeseen keeps its traceback, for a report to us."""
    from studies.environment import explain
    from studies.pipeline import StageError

    explained = explain(error)
    if explained is None and not isinstance(error, StageError):
        traceback.print_exception(error)
    line = explained or " ".join(f"{error}".split()) or type(error).__name__
    console.warn(f"error: {line}")
    console.document({"error": line})
    return FAILED
