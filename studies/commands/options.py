"""Options that several commands share."""

from studies.commands.values import Option, address, positive, whole, window

NATIVE_CODE = "an FMU is native code that runs with your rights; SECURITY.md says how to run one apart"

JOBS = Option("--jobs", type=whole(1), metavar="N", help="processes; default: the number of cores")
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
TRIALS = (
    Option("--trials", type=whole(1), metavar="N", help="trials per size in total; default: the profile's"),
    Option("--dry-run", action="store_true", help="show the plan and its duration; write nothing"),
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
