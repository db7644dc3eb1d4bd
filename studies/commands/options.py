"""Options that several commands share, and what their words may be; anything else is refused in one line."""

import argparse
import sys
from pathlib import Path
from typing import Any

from studies.keywords import CHOICES, READERS


class Option:
    """An option or argument of a command, as `argparse` adds it."""

    def __init__(self, *names: str, **how: Any) -> None:
        """Take what `add_argument` takes; what the words may be follows from the last name."""
        keyword = names[-1].lstrip("-").replace("-", "_")
        if keyword in CHOICES:
            how.setdefault("choices", CHOICES[keyword])
        elif keyword in READERS:
            how.setdefault("type", READERS[keyword])
        self.names, self.how = names, how


JOBS = Option("--jobs", metavar="N", help="processes; default: the number of cores")
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
        metavar="A-B",
        help="days of the recording, e.g. 8-16, or with a unit: 0-10s, 2-8h; default: the case's own",
    ),
    Option(
        "--simulations",
        metavar="N",
        help="most simulations of a whole run; surrogates are then cross-validated; default: the profile's",
    ),
    Option(
        "--surrogate",
        help="refined: a PELS-VAE of networks (default); paper: the same with the settings of the paper; "
        "pca-gp: PCA and Gaussian processes",
    ),
)
SIMULATION = (
    Option("--retry-failed", action="store_true", help="retry failed simulations"),
    Option(
        "--dask",
        metavar="ADDRESS",
        help="simulate on a Dask cluster, e.g. tcp://scheduler:8786; default: on this machine",
    ),
)
SIMULATED = (*CASE, *SIMULATION)
FMU = Option(
    "--fmu",
    action="store_true",
    help="Sobol indices of the FMU, by simulations; default: of the best surrogate",
)
MAX_HOURS = Option(
    "--max-hours",
    metavar="H",
    help="begin no simulation and no trial after H hours; the same command continues later",
)
DRY_RUN = Option("--dry-run", action="store_true", help="show the plan and how long it takes; write nothing")
TRIALS = (
    Option("--trials", metavar="N", help="trials per size in total; default: the profile's"),
    DRY_RUN,
)


def experiment(help_line: str) -> Option:
    """Return the option that names an experiment of a case that has several."""
    return Option("--experiment", metavar="NAME", help=help_line)


def sizes(help_line: str) -> Option:
    """Return the option that names training-set sizes."""
    return Option("--n-train", nargs="+", metavar="N", help=help_line)


def calls(help_line: str) -> tuple[Option, ...]:
    """Return how many calls may be spent, and whether what is finished is repeated."""
    return (
        Option("--max-calls", metavar="N", help=help_line),
        Option("--again", action="store_true", help="repeat what is finished"),
    )


CALIBRATION = (
    Option(
        "--method",
        help="method of the calibration; default: adaptive if there is one",
    ),
    sizes("the calibration with this training-set size; default: the best"),
)
TUNING = (
    sizes("training-set sizes; default: the profile's"),
    *TRIALS,
    Option(
        "--parallel",
        metavar="N",
        help="trials of one size at the same time; default: 1, which makes the trials repeatable",
    ),
    MAX_HOURS,
)
OBJECTIVE = Option(
    "--objective",
    metavar="MODULE:FUNCTION",
    help="a function of yours that takes a trial and returns a number, or several",
)


def find_modules(chosen: argparse.Namespace) -> None:
    """Let Python find a function that was named in modules of the working folder."""
    if chosen.objective is not None:
        sys.path.insert(0, str(Path.cwd()))


EVERYWHERE = (
    Option(
        "--storage",
        metavar="URL",
        help="PostgreSQL database of Optuna and MLflow, e.g. postgresql://user@host/database; "
        "default: $STUDIES_STORAGE, else files in mlruns/",
    ),
    Option(
        "--tracking",
        metavar="URL",
        help="MLflow server that runs are also sent to, or `local` for none; default: $MLFLOW_TRACKING_URI, "
        "else `tracking` in studies.toml",
    ),
    Option("--json", action="store_true", help="write one JSON document to stdout, all else to stderr"),
    Option("-q", "--quiet", action="store_true", help="write only results and errors"),
)
