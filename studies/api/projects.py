"""`best`, `compare`, `status` and `reproduce`: what a project holds; and `load_case`."""

from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError
from studies.api.verb import shown, verb
from studies.paths import find_case, find_project
from studies.server import LOCAL
from studies.words.console import Console

if TYPE_CHECKING:
    import pandas as pd

    from simulation.case import Case
    from studies.comparison import ComparedSize
    from studies.project import Project
    from studies.reproduction import Compared
    from studies.tuning.live_trial import Objective


@dataclass(frozen=True, eq=False)
class ProjectResult:
    """The studies and calibrations of a project.

    Attributes:
        project: All that was read.
    """

    project: "Project"

    @cached_property
    def sizes(self) -> "pd.DataFrame":
        """A row per Optuna study: label, training-set size, trials, and the errors of the best one."""
        import pandas as pd

        return pd.DataFrame(map(asdict, self.project.sizes))

    @cached_property
    def calibrations(self) -> "pd.DataFrame":
        """A row per finished calibration: name, error, calls, converged, and what changed since."""
        import pandas as pd

        rows = [
            {
                "name": one.name,
                "mse": one.found.mse,
                "calls": one.found.n_calls,
                "converged": one.found.converged,
                "finished": one.outcome.finished,
                "changed_since": list(one.changed_since),
            }
            for one in self.project.calibrations
        ]
        return pd.DataFrame(rows)


@dataclass(frozen=True, eq=False)
class BestResult(ProjectResult):
    """The best of a project, with the lines by which other programs load it."""

    @property
    def numbers(self) -> dict[str, Any]:
        """What `studies best --json` says: the best trial of each size, the best calibrations, and stores."""
        from studies.project import best_document

        return best_document(self.project)


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """Two labels beside each other.

    Attributes:
        labels: The labels that were compared.
        sizes: What both came to at each training-set size, and which is better.
    """

    labels: tuple[str, str]
    sizes: "tuple[ComparedSize, ...]"

    @cached_property
    def table(self) -> "pd.DataFrame":
        """A row per training-set size: errors, seeds, trials and simulations of both, and which is better."""
        import pandas as pd

        return pd.json_normalize([asdict(one) for one in self.sizes], max_level=1).set_index("n_train")


@dataclass(frozen=True, eq=False)
class ReproductionResult:
    """A recorded result and the same once more.

    Attributes:
        run_id: MLflow's run that was repeated.
        rows: Every number that was compared.
    """

    run_id: str
    rows: "tuple[Compared, ...]"

    @property
    def is_equal(self) -> bool:
        """Whether every number is the same to the last digit."""
        return all(row.is_equal for row in self.rows)


@verb
def best(which: str | None = None, *, storage: str | None = None, tracking: str | None = None) -> BestResult:
    """Return the best surrogates and calibrations of a project, as `studies best`.

    Args:
        which: A case, a label or a pattern of labels; None for everything.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.

    Raises:
        InputError: Nothing is called so.
    """
    from studies.project import read_project

    return BestResult(read_project(find_project(storage, tracking), which))


@verb
def compare(
    first: str, second: str, *, storage: str | None = None, tracking: str | None = None
) -> ComparisonResult:
    """Compare two profiles or labels, size by size, as `studies compare`.

    Args:
        first: A label, a pattern of one label, or the name or file of a profile.
        second: What it is compared with.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.

    Raises:
        InputError: Nothing, or more than one label, is called so, or both are one.
    """
    from studies.comparison import compared_sizes, label_called
    from studies.project import read_project

    project = read_project(find_project(storage, tracking))
    labels = label_called(project, first), label_called(project, second)
    if labels[0] == labels[1]:
        raise InputError(f"{first!r} and {second!r} are both {labels[0]}; give two labels or profiles")
    return ComparisonResult(labels, tuple(compared_sizes(project, labels)))


@verb
def status(
    which: str | None = None, *, storage: str | None = None, tracking: str | None = None
) -> ProjectResult:
    """Return what a project holds, finished or not, as `studies status`.

    Args:
        which: A case, a label or a pattern of labels; None for everything.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.

    Raises:
        InputError: Nothing is called so.
    """
    from studies.project import read_project

    return ProjectResult(read_project(find_project(storage, tracking), which))


@verb
def reproduce(
    run: str,
    *,
    objective: "Objective | str | None" = None,
    jobs: int | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> ReproductionResult:
    """Repeat a recorded result and compare every number, as `studies reproduce`.

    Args:
        run: Id of an MLflow run, or the name of a calibration.
        objective: The function, or "module:function", of a trial of yours: no record names what is run.
        jobs: Processes; None for the number of cores.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Raises:
        InputError: There is no such result, or it cannot be repeated here.
    """
    from simulation.pool.pool_model import available_cores
    from studies.reproduction import reproduce as repeated

    paths = find_project(storage, tracking)
    n_jobs = jobs or available_cores()
    run_id, rows = repeated(paths, run, shown(console), n_jobs=n_jobs, objective=objective)
    return ReproductionResult(run_id, tuple(rows))


def load_case(case: str | Path = "office") -> "Case":
    """Read a case of the project or an embedded one.

    Args:
        case: Name, file or folder of a case.

    Raises:
        InputError: There is none, or something in its files is wrong.
    """
    from simulation.case import load_case as read_case

    return read_case(find_case(find_project(None, LOCAL), str(case)))
