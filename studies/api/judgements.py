"""`check`, `uncertainty`, `predict` and `report`: what is to be thought of a case and of its calibration."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError
from studies.api.result import Result
from studies.api.verb import HasPath, opened, verb
from studies.doctor.finding import Diagnosis
from studies.keywords import Method, Noise, Surrogate
from studies.opening import sizes
from studies.results.outcome import Outcome
from studies.results.profiled import Profiles
from studies.results.stage_results import Calibration, Prediction, Reported, Uncertainty
from studies.task import StageError
from studies.words.console import Console
from studies.words.wording import NATIVE_CODE

if TYPE_CHECKING:
    import pandas as pd

    from studies.task import Task


class CheckResult(Result[Diagnosis]):
    """What an examination of a case came to."""

    @property
    def is_sound(self) -> bool:
        """Whether nothing failed."""
        return self.outcome.result.is_sound

    @cached_property
    def findings(self) -> "pd.DataFrame":
        """A row per examination: what, level (ok, warn or fail), found, remedy."""
        import pandas as pd

        return pd.DataFrame([vars(one) for one in self.outcome.result.findings])


class UnsoundError(StageError):
    """An examination found errors, so that nothing was begun.

    Attributes:
        checked: What it found.
    """

    def __init__(self, checked: CheckResult) -> None:
        """Say how to see the errors."""
        task = checked.task
        super().__init__(f"{task.label}: studies check {task.command} found errors; type it, it says which")
        self.checked = checked


@dataclass(frozen=True, eq=False)
class UncertaintyResult(Result[Uncertainty]):
    """How sure a calibration is.

    Attributes:
        profiled: Its profile likelihoods, None where they were not asked for.
    """

    profiled: Outcome[Profiles] | None = None

    @cached_property
    def profiles(self) -> "pd.DataFrame":
        """A row per parameter: interval of the profile, bounds reached, rise by simulation, what moves."""
        import pandas as pd

        found = {} if self.profiled is None else self.profiled.result.parameters
        rows = {name: vars(one) for name, one in found.items()}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    @cached_property
    def parameters(self) -> "pd.DataFrame":
        """A row per parameter: calibrated value, interval, and what the data say of it. [per parameter]."""
        import pandas as pd

        found = self.outcome.result
        rows = {name: vars(one) for name, one in found.parameters.items()}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    @cached_property
    def sample(self) -> "pd.DataFrame":
        """Parameter sets of the posterior, with their weights. [per parameter]."""
        import pandas as pd

        found = self.outcome.result
        frame = pd.DataFrame(found.sample_theta, columns=[*found.parameters])
        return frame.assign(weight=found.weights)


class PredictionResult(Result[Prediction]):
    """A calibrated model with other inputs."""

    @cached_property
    def table(self) -> "pd.DataFrame":
        """Outputs over time in seconds, with the bands where there is an uncertainty. [per output]."""
        import pandas as pd

        return pd.DataFrame(dict(self.outcome.result.columns())).set_index("time_s")


class ReportResult(Result[Reported]):
    """The page of a case and a profile."""

    @property
    def page(self) -> Path:
        """Its file."""
        return self.task.paths.root / self.outcome.result.index


@verb
def check(
    case: str | Path | HasPath = "office",
    *,
    thorough: bool = False,
    max_minutes: float | None = None,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    simulations: int | None = None,
    surrogate: Surrogate | None = None,
    jobs: int | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> CheckResult:
    """Examine a case before its simulations are paid for, as `studies check`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        thorough: Skip no examination, however long the simulations take.
        max_minutes: Simulating time after the first simulation; None for 10. [min]
        profile: Budget: "quick", "thorough", "paper", or a profile file.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the case's own.
        seed: Seed of all random numbers; None for the profile's.
        simulations: Most simulations of a whole run; None for the profile's.
        surrogate: Form of the surrogate; None for the profile's.
        jobs: Processes; None for the number of cores.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        The findings.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    task = opened("check", locals())
    from studies.doctor.budget import EXAMINATION_S
    from studies.stages.check_stage import check_stage

    task.console.say(NATIVE_CODE)
    limit_s = EXAMINATION_S if max_minutes is None else 60.0 * max_minutes
    found = check_stage(task, again=True, is_thorough=thorough, limit_s=limit_s)
    return CheckResult(task, found)


@verb
def uncertainty(
    case: str | Path | HasPath = "office",
    *,
    method: Method | None = None,
    n_train: int | None = None,
    noise: Noise = "correlated",
    max_calls: int | None = None,
    profiles: bool = False,
    max_hours: float | None = None,
    again: bool = False,
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
) -> UncertaintyResult:
    """Say how sure the calibration is, as `studies uncertainty`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        method: Method of the calibration; None for adaptive if there is one.
        n_train: The calibration with this training-set size; None for the best.
        noise: Model of the residuals.
        max_calls: Most simulations; None for 20 per parameter, at least 100.
        profiles: Follow the profile likelihoods too, for 2 more simulations per parameter, and one.
        max_hours: No simulation begins later; the same call continues. [h]
        again: Repeat it if it is finished.
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
        Intervals, a sample of the posterior, and which parameters compensate each other.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    task = opened("uncertainty", locals())
    from studies.stages.uncertainty_stage import calibration_to_judge

    calibration = calibration_to_judge(task, method, sizes(n_train))
    return uncertainty_of(task, calibration, noise=noise, max_calls=max_calls, profiles=profiles, again=again)


def uncertainty_of(
    task: "Task",
    calibration: Outcome[Calibration],
    *,
    noise: Noise,
    max_calls: int | None,
    profiles: bool,
    again: bool,
) -> UncertaintyResult:
    """Say how sure a calibration is.

    Args:
        task: The task.
        calibration: A calibration of it.
        noise: Model of the residuals.
        max_calls: Most simulations; None for the usual number.
        profiles: Follow the profile likelihoods too.
        again: Repeat it if it is finished.
    """
    from studies.stages.uncertainty_stage import uncertainty_stage, usual_calls

    n = max_calls or usual_calls(task.case.parameter_space.n_parameters)
    found = uncertainty_stage(task, calibration, noise=noise, max_calls=n, again=again)
    if not profiles:
        return UncertaintyResult(task, found)
    from studies.stages.profile_stage import profile_stage

    return UncertaintyResult(task, found, profile_stage(task, calibration, found, again=again))


@verb
def predict(
    case: str | Path | HasPath = "office",
    *,
    inputs: "str | Path | pd.DataFrame | None" = None,
    experiment: str | None = None,
    method: Method | None = None,
    n_train: int | None = None,
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
) -> PredictionResult:
    """Simulate the calibrated model with other inputs, as `studies predict`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        inputs: A CSV file, a folder of such files, or a frame, with the columns of the case's inputs.
        experiment: The experiment to simulate, of a case with several.
        method: Method of the calibration; None for adaptive if there is one.
        n_train: The calibration with this training-set size; None for the best.
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
        Outputs over time, with bands after `uncertainty`.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    if inputs is None and experiment is None:
        raise InputError("predict needs --inputs FILE, or --experiment NAME of a case with experiments")
    task = opened("predict", locals())
    from studies.stages.uncertainty_stage import calibration_to_judge

    return prediction_of(task, calibration_to_judge(task, method, sizes(n_train)), inputs, experiment)


def prediction_of(
    task: "Task", calibration: Outcome[Calibration], inputs: Any, experiment: str | None
) -> PredictionResult:
    """Simulate a calibration with other inputs.

    Args:
        task: The task.
        calibration: A calibration of it.
        inputs: A file, a folder, a frame, or None for the recording of an experiment.
        experiment: The experiment; None where the case has none.
    """
    from studies.stages.predict_stage import predict_stage

    if hasattr(inputs, "to_csv"):
        inputs = _as_file(task, inputs)
    file = None if inputs is None else Path(inputs)
    return PredictionResult(task, predict_stage(task, calibration, file, experiment))


def _as_file(task: "Task", frame: "pd.DataFrame") -> Path:
    """Write a frame of inputs beside the results; equal frames are one file."""
    from simulation.arrays import digest_of
    from simulation.whole_file import whole_file

    is_indexed = frame.index.name is not None
    text = frame.to_csv(index=is_indexed)
    file = task.results / f"inputs-{digest_of(text)[:8]}.csv"
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as stream:
        stream.write(text.encode())
    return file


@verb
def report(
    case: str | Path | HasPath = "office",
    *,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    simulations: int | None = None,
    surrogate: Surrogate | None = None,
    jobs: int | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> ReportResult:
    """Write the page of a case and a profile, as `studies report`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        profile: Budget: "quick", "thorough", "paper", or a profile file.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the case's own.
        seed: Seed of all random numbers; None for the profile's.
        simulations: Most simulations of a whole run; None for the profile's.
        surrogate: Form of the surrogate; None for the profile's.
        jobs: Processes; None for the number of cores.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        The page.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    task = opened("report", locals())
    from studies.stages.report_stage import report_stage

    return ReportResult(task, report_stage(task))
