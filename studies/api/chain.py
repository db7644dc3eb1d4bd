"""`run`, `tune`, `simulate` and `sensitivity`: the chain of the paper, and its parts."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError
from simulation.trajectories import Trajectories
from studies.api.calibrations import CalibrationResult, best_of
from studies.api.judgements import CheckResult, UnsoundError
from studies.api.result import Result
from studies.api.verb import DEFAULTS, HasPath, opened, verb
from studies.calibration.sobol import SobolIndices
from studies.keywords import Surrogate
from studies.results.outcome import Outcome
from studies.results.row_set import RowSet
from studies.results.stage_results import Calibration, SimulatedSets, Tuned
from studies.words.console import Console

if TYPE_CHECKING:
    import pandas as pd

    from studies.api.objectives import ObjectiveResult
    from studies.stages.budget_stage import Spent
    from studies.task import Task
    from studies.tuning.live_trial import Objective


class SimulationResult(Result[SimulatedSets]):
    """The sets of simulations behind the surrogates."""

    def read(self, name: str) -> Trajectories:
        """Read a set: parameters, outputs and output times.

        Args:
            name: "train", "validation" or "test".
        """
        return RowSet.load(self.task.paths.root / self.outcome.result.files[name]).read()


class SensitivityResult(Result[SobolIndices]):
    """Sobol indices of the outputs."""

    @cached_property
    def indices(self) -> "pd.DataFrame":
        """Indices by parameter, means over time weighted by the variance: columns first, total. [1]."""
        import pandas as pd

        mean = self.outcome.result.mean
        return pd.DataFrame.from_dict(mean, orient="index", columns=["first", "total"])


@dataclass(frozen=True, eq=False)
class TuningResult:
    """The best surrogate of each training-set size.

    Attributes:
        task: Case, profile and project.
        stages: What each stage came to, in order; the last one is the tuning.
    """

    task: "Task"
    stages: tuple[Outcome[Any], ...]

    @property
    def tuned(self) -> Tuned:
        """What the tuning came to."""
        result: Tuned = self.stages[-1].result
        return result

    @cached_property
    def sizes(self) -> "pd.DataFrame":
        """A row per size with the fields of `studies best --json`.

        Among them are the hyperparameters `params`, the test errors `mae` and `p90` in `unit`, and the
        `model_uri` by which MLflow loads the model.
        """
        import pandas as pd

        return pd.DataFrame(map(asdict, self.tuned.studies)).set_index("n_train")

    def _repr_html_(self) -> str:
        table = self.sizes[["n_trials", "n_pruned", "mae", "p90", "unit"]]
        return str(table.to_html(float_format="{:.4g}".format))


@dataclass(frozen=True, eq=False, repr=False)
class RunResult(CalibrationResult):
    """All that `studies run` came to; itself it is the calibration of least error.

    Attributes:
        spent: What it took of its budget of simulations; None without one.
    """

    spent: "Spent | None" = None

    @property
    def calibrations(self) -> list[CalibrationResult]:
        """The calibration of each training-set size."""
        own = [one for one in self.stages if isinstance(one.result, Calibration)]
        return [CalibrationResult(self.task, self.stages, one) for one in own]

    @property
    def tuning(self) -> TuningResult:
        """The best surrogate of each training-set size."""
        n = next(k for k, one in enumerate(self.stages) if isinstance(one.result, Tuned))
        return TuningResult(self.task, self.stages[: n + 1])

    @property
    def page(self) -> Path:
        """The report."""
        page: Path = self.task.paths.root / self.stages[-1].result.index
        return page


@verb
def simulate(
    case: str | Path | HasPath = "office",
    *,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    simulations: int | None = None,
    surrogate: Surrogate | None = None,
    retry_failed: bool = False,
    jobs: int | None = None,
    dask: str | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> SimulationResult:
    """Simulate the training, validation and test sets, as `studies simulate`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        profile: Budget: "quick", "thorough", "paper", or a profile file.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the case's own.
        seed: Seed of all random numbers; None for the profile's.
        simulations: Most simulations of a whole run; None for the profile's.
        surrogate: Form of the surrogate; None for the profile's.
        retry_failed: Simulate failed simulations again.
        jobs: Processes; None for the number of cores.
        dask: Address of a Dask scheduler whose workers simulate; None for this machine.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        The sets.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    task = opened("simulate", locals())
    from studies.stages.simulate_stage import simulate_stage

    return SimulationResult(task, simulate_stage(task))


@verb
def sensitivity(
    case: str | Path | HasPath = "office",
    *,
    fmu: bool = False,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    simulations: int | None = None,
    surrogate: Surrogate | None = None,
    retry_failed: bool = False,
    jobs: int | None = None,
    dask: str | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> SensitivityResult:
    """Say which parameters the outputs depend on, as `studies sensitivity`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        fmu: Ask the FMU, by simulations; False for what the profile says, mostly the best surrogate.
        profile: Budget: "quick", "thorough", "paper", or a profile file.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the case's own.
        seed: Seed of all random numbers; None for the profile's.
        simulations: Most simulations of a whole run; None for the profile's.
        surrogate: Form of the surrogate; None for the profile's.
        retry_failed: Simulate failed simulations again.
        jobs: Processes; None for the number of cores.
        dask: Address of a Dask scheduler whose workers simulate; None for this machine.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        Sobol indices.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    task = opened("sensitivity", locals())
    from studies.stages.sensitivity_stage import sensitivity_stage

    return SensitivityResult(task, sensitivity_stage(task))


@verb
def tune(
    case: str | Path | HasPath = "office",
    *,
    objective: "Objective | str | None" = None,
    name: str | None = None,
    values: str | Sequence[str] | None = None,
    maximize: str | Sequence[str] | None = None,
    n_train: int | Sequence[int] | None = None,
    trials: int | None = None,
    parallel: int | None = None,
    max_hours: float | None = None,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    simulations: int | None = None,
    surrogate: Surrogate | None = None,
    retry_failed: bool = False,
    jobs: int | None = None,
    dask: str | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> "TuningResult | ObjectiveResult":
    """Tune one surrogate per training-set size with Optuna, or an objective of yours, as `studies tune`.

    An objective takes a trial and returns a number, or several. The trial is Optuna's (`suggest_float`,
    `report`, `should_prune`, `set_constraint`), with `trial.seed`, `trial.log({"mae": 0.1}, step=3)` and
    `trial.log_file("picture.png")`, which MLflow shows while the trial runs.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        objective: A function that takes a trial, or "module:function"; None to tune surrogates of a case.
        name: What the objective's study is called; None for the name of the function.
        values: Names of what the objective returns, in its order; None for "value".
        maximize: Those of the values that are maximized; None to minimize all.
        n_train: Training-set sizes; None for the profile's.
        trials: Trials per size, or of the objective, in all; None for the profile's.
        parallel: Trials of one size at the same time; None for 1, which makes the trials repeatable.
        max_hours: No simulation and no trial begins later; the same call continues. [h]
        profile: Budget: "quick", "thorough", "paper", or a profile file; of an objective a file with
            [tuning], and without one 100 trials of TPESampler and MedianPruner.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the case's own.
        seed: Seed of all random numbers; None for the profile's.
        simulations: Most simulations of a whole run; None for the profile's.
        surrogate: Form of the surrogate; None for the profile's.
        retry_failed: Simulate failed simulations again.
        jobs: Processes; None for the number of cores.
        dask: Address of a Dask scheduler whose workers simulate; None for this machine.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        The best surrogate of each size, or what the trials of the objective came to.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    if objective is not None:
        from studies.api.objectives import tuned_by

        return tuned_by(objective, locals(), DEFAULTS["tune"])
    for key, value in {"name": name, "values": values, "maximize": maximize}.items():
        if value is not None:
            raise InputError(f"{key} = {value} is of an objective; give one, or leave it out")
    task = opened("tune", locals())
    from studies.stages.learn import require_tuning, tune_stage
    from studies.stages.simulate_stage import simulate_stage

    require_tuning(task)
    simulated = simulate_stage(task)
    return TuningResult(task, (simulated, tune_stage(task, simulated)))


@verb
def run(
    case: str | Path | HasPath = "office",
    *,
    n_train: int | Sequence[int] | None = None,
    trials: int | None = None,
    parallel: int | None = None,
    max_hours: float | None = None,
    max_calls: int | None = None,
    again: bool = False,
    fmu: bool = False,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    simulations: int | None = None,
    surrogate: Surrogate | None = None,
    retry_failed: bool = False,
    jobs: int | None = None,
    dask: str | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> RunResult:
    """Do all stages of the paper in order, as `studies run`, and skip finished ones.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        n_train: Training-set sizes; None for the profile's.
        trials: Trials per size in all; None for the profile's.
        parallel: Trials of one size at the same time; None for 1, which makes the trials repeatable.
        max_hours: No simulation and no trial begins later; the same call continues. [h]
        max_calls: Most simulations of one polish; None for the profile's.
        again: Repeat the calibrations if they are finished.
        fmu: Sobol indices of the FMU; False for what the profile says, mostly of the best surrogate.
        profile: Budget: "quick", "thorough", "paper", or a profile file.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the case's own.
        seed: Seed of all random numbers; None for the profile's.
        simulations: Most simulations of a whole run; None for the profile's.
        surrogate: Form of the surrogate; None for the profile's.
        retry_failed: Simulate failed simulations again.
        jobs: Processes; None for the number of cores.
        dask: Address of a Dask scheduler whose workers simulate; None for this machine.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        The calibration of least error, with those of all sizes, the tuning and the page.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed, or the check found errors (UnsoundError).
    """
    task = opened("run", locals())
    from studies.doctor import say_warnings
    from studies.forecast import warn_of_hours
    from studies.stages.calibrate_stage import calibrate_stage, polisher
    from studies.stages.check_stage import check_stage
    from studies.stages.learn import require_tuning, tune_stage
    from studies.stages.report_stage import report_stage
    from studies.stages.sensitivity_stage import sensitivity_stage
    from studies.stages.simulate_stage import simulate_stage

    require_tuning(task)
    polisher(task.profile)
    if task.profile.is_budgeted:
        from studies.doctor.begin import say_begin
        from studies.stages.budget_stage import run_within_budget

        say_begin(task.case, task.console)
        stages, spent = run_within_budget(task, again=again)
        stages = (*stages, report_stage(task))
        return RunResult(task, stages, best_of(task, stages).outcome, spent)
    checked = check_stage(task)
    if not checked.result.is_sound:
        raise UnsoundError(CheckResult(task, checked))
    say_warnings(task.console, checked.result)
    warn_of_hours(task)
    simulated = simulate_stage(task)
    before = [checked, simulated, tune_stage(task, simulated), sensitivity_stage(task)]
    sizes = task.profile.data.n_train
    calibrated = [calibrate_stage(task, n, again=again) for n in sizes]
    stages = (*before, *calibrated, report_stage(task))
    return RunResult(task, stages, best_of(task, calibrated).outcome)
