"""Options that several commands share, and what their words may be; anything else is refused in one line."""

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from typing import Any


class Option:
    """An option or argument of a command, as `argparse` adds it."""

    def __init__(self, *names: str, **how: Any) -> None:
        """Take what `add_argument` takes."""
        self.names, self.how = names, how


@dataclass(frozen=True)
class Window:
    """A part of the recording.

    Attributes:
        begin: Its begin. [unit]
        end: Its end. [unit]
        unit: s, min, h or d.
    """

    begin: float
    end: float
    unit: str = "d"

    @property
    def days(self) -> tuple[float, float]:
        """Begin and end. [d]."""
        # Here, because the command line imports nothing heavy.
        from simulation.time_unit import UNITS

        return UNITS[self.unit].to_days(self.begin), UNITS[self.unit].to_days(self.end)

    @property
    def label(self) -> str:
        """How results of this window are distinguished: d8-16."""
        return f"{self.unit}{_all_digits(self.begin)}-{_all_digits(self.end)}"

    def __str__(self) -> str:
        """Return what can be typed."""
        return f"{_all_digits(self.begin)}-{_all_digits(self.end)}{'' if self.unit == 'd' else self.unit}"


def _all_digits(value: float) -> str:
    """Write a number without an exponent, which the reader of windows refuses."""
    return f"{Decimal(repr(value)).normalize():f}"


def window(text: str) -> Window:
    """Read two ascending days, 0-10, or times of another unit, 0-10s."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)(s|min|h|d)?", text)
    if found is None or float(found[1]) >= float(found[2]):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no window; give two ascending days, e.g. 0-10, or with a unit: 0-600s, 2-8h"
        )
    return Window(float(found[1]), float(found[2]), found[3] or "d")


def whole(least: int, most: int = 1_000_000) -> Callable[[str], int]:
    """Return a reader of whole numbers between two limits."""

    def read(text: str) -> int:
        if not re.fullmatch(r"\d+", text) or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least {least}")
        if int(text) > most:
            raise argparse.ArgumentTypeError(f"{text!r} is too large; give {most} at most")
        return int(text)

    return read


def positive(text: str) -> float:
    """Read a positive number."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def address(text: str) -> str:
    """Read the address of a Dask scheduler."""
    if not re.fullmatch(r"(tcp|tls|ws|wss)://\S+:\d+", text):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no scheduler's address; give e.g. tcp://scheduler:8786"
        )
    return text


NATIVE_CODE = "an FMU is native code that runs with your rights; SECURITY.md says how to run one apart"

JOBS = Option("--jobs", type=whole(1), metavar="N", help="processes; default: the number of cores")
WHICH = Option(
    "which", nargs="?", metavar="CASE", help="a case, a label, or a pattern of labels; default: all"
)
NAME = (
    Option(
        "case",
        nargs="?",
        default="office",
        metavar="CASE",
        help="name, file or folder of a case; default: office",
    ),
    Option(
        "--seed",
        type=whole(0, 2**32 - 1),
        metavar="N",
        help="seed of all random numbers; default: the profile's",
    ),
    JOBS,
)
CASE = (
    *NAME,
    Option(
        "--profile",
        default="quick",
        metavar="NAME",
        help="budget: quick (default), thorough, paper, or a profile file",
    ),
    Option(
        "--window",
        type=window,
        metavar="A-B",
        help="days of the recording, e.g. 8-16, or with a unit: 0-10s, 2-8h; default: the case's own",
    ),
    Option(
        "--surrogate",
        choices=("refined", "paper", "pca-gp"),
        help="refined: a PELS-VAE of networks (default); paper: the same with the settings of the paper; "
        "pca-gp: PCA and Gaussian processes",
    ),
)
SIMULATION = (
    Option("--retry-failed", action="store_true", help="retry failed simulations"),
    Option(
        "--dask",
        type=address,
        metavar="ADDRESS",
        help="simulate on a Dask cluster, e.g. tcp://scheduler:8786; default: on this machine",
    ),
)
SIMULATED = (*CASE, *SIMULATION)
TRIALS = (
    Option("--trials", type=whole(1), metavar="N", help="trials per size in total; default: the profile's"),
    Option("--dry-run", action="store_true", help="show the plan and known durations; write nothing"),
)


def experiment(help_line: str) -> Option:
    """Return the option that names an experiment of a case that has several."""
    return Option("--experiment", metavar="NAME", help=help_line)


def sizes(help_line: str) -> Option:
    """Return the option that names training-set sizes."""
    return Option("--n-train", nargs="+", type=whole(4), metavar="N", help=help_line)


def calls(help_line: str) -> tuple[Option, ...]:
    """Return how many calls may be spent, and whether what is finished is repeated."""
    return (
        Option("--max-calls", type=whole(1), metavar="N", help=help_line),
        Option("--again", action="store_true", help="repeat what is finished"),
    )


CALIBRATION = (
    Option(
        "--method",
        choices=("paper", "adaptive"),
        help="method of the calibration; default: adaptive if there is one",
    ),
    sizes("the calibration with this training-set size; default: the best"),
)
TUNING = (
    sizes("training-set sizes; default: the profile's"),
    *TRIALS,
    Option(
        "--parallel",
        type=whole(1, 1000),
        metavar="N",
        help="trials of one size at the same time; default: 1, which makes the trials repeatable",
    ),
    Option(
        "--max-hours",
        type=positive,
        metavar="H",
        help="start no trial after H hours; the same command continues later",
    ),
)
EVERYWHERE = (
    Option(
        "--storage",
        metavar="URL",
        help="PostgreSQL database of Optuna and MLflow, e.g. postgresql://user@host/database; "
        "default: $STUDIES_STORAGE, else files in mlruns/",
    ),
    Option("--json", action="store_true", help="write one JSON document to stdout, all else to stderr"),
    Option("-q", "--quiet", action="store_true", help="write only results and errors"),
)
