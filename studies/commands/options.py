"""Options that several commands share."""

import argparse

from studies.commands import values

NATIVE_CODE = "an FMU is native code that runs with your rights; SECURITY.md says how to run one apart"


def add_name(command: argparse.ArgumentParser) -> None:
    """Which case, seed, and how many processes."""
    command.add_argument(
        "case",
        nargs="?",
        default="office",
        metavar="CASE",
        help="name, file or folder of a case; default: office",
    )
    command.add_argument(
        "--seed",
        type=values.whole(0, 2**32 - 1),
        metavar="N",
        help="seed of all random numbers; default: the profile's",
    )
    add_jobs(command)


def add_jobs(command: argparse.ArgumentParser) -> None:
    """How many processes."""
    command.add_argument(
        "--jobs", type=values.whole(1), metavar="N", help="processes; default: the number of cores"
    )


def add_case(command: argparse.ArgumentParser) -> None:
    """Which case, seed, budget, window, and how many processes."""
    add_name(command)
    command.add_argument(
        "--profile",
        default="quick",
        metavar="NAME",
        help="budget: quick (default), thorough, paper, or a profile file",
    )
    command.add_argument(
        "--window",
        type=values.window,
        metavar="A-B",
        help="days of the recording, e.g. 8-16, or with a unit: 0-10s, 2-8h; default: the case's own",
    )
    command.add_argument(
        "--surrogate",
        choices=("refined", "paper", "pca-gp"),
        help="refined: a PELS-VAE of networks (default); paper: the same with the settings of the paper; "
        "pca-gp: PCA and Gaussian processes",
    )


def add_experiment(command: argparse.ArgumentParser, what: str) -> None:
    """Which experiment of a case that has several."""
    command.add_argument("--experiment", metavar="NAME", help=what)


def add_simulation(command: argparse.ArgumentParser) -> None:
    """Options of commands that simulate."""
    command.add_argument("--retry-failed", action="store_true", help="retry failed simulations")
    command.add_argument(
        "--dask",
        type=values.address,
        metavar="ADDRESS",
        help="simulate on a Dask cluster, e.g. tcp://scheduler:8786; default: on this machine",
    )


def add_sizes(command: argparse.ArgumentParser, help_line: str) -> None:
    """Training-set sizes."""
    command.add_argument("--n-train", nargs="+", type=values.whole(4), metavar="N", help=help_line)


def add_calibration(command: argparse.ArgumentParser) -> None:
    """Which stored calibration."""
    command.add_argument(
        "--method",
        choices=("paper", "adaptive"),
        help="method of the calibration; default: adaptive if there is one",
    )
    add_sizes(command, "the calibration with this training-set size; default: the best")


def add_trials(command: argparse.ArgumentParser) -> None:
    """How many trials, or only what would be done."""
    command.add_argument(
        "--trials",
        type=values.whole(1),
        metavar="N",
        help="trials per size in total; default: the profile's",
    )
    command.add_argument(
        "--dry-run", action="store_true", help="show the plan and its duration; write nothing"
    )


def add_tuning(command: argparse.ArgumentParser) -> None:
    """How much is tuned."""
    add_sizes(command, "training-set sizes; default: the profile's")
    add_trials(command)
    command.add_argument(
        "--parallel",
        type=values.whole(1, 1000),
        metavar="N",
        help="trials of one size at the same time; default: 1, which makes the trials repeatable",
    )
    command.add_argument(
        "--max-hours",
        type=values.positive,
        metavar="H",
        help="start no trial after H hours; the same command continues later",
    )


def add_calls(command: argparse.ArgumentParser, help_line: str) -> None:
    """How many calls may be spent, and whether what is finished is repeated."""
    command.add_argument("--max-calls", type=values.whole(1), metavar="N", help=help_line)
    command.add_argument("--again", action="store_true", help="repeat what is finished")


def add_storage(command: argparse.ArgumentParser) -> None:
    """Database of Optuna's studies and MLflow's runs."""
    command.add_argument(
        "--storage",
        metavar="URL",
        help="PostgreSQL database of Optuna and MLflow, e.g. postgresql://user@host/database; "
        "default: $STUDIES_STORAGE, else files in mlruns/",
    )


def add_output(command: argparse.ArgumentParser) -> None:
    """Form and amount of the output."""
    command.add_argument(
        "--json", action="store_true", help="write one JSON document to stdout, all else to stderr"
    )
    command.add_argument("-q", "--quiet", action="store_true", help="write only results and errors")
