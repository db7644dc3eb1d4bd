"""`choose` and `next_experiment`: which model structure the data choose, and what to measure next."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from studies.api.result import Result
from studies.api.verb import HasPath, opened, verb
from studies.keywords import Criterion, Method, Noise, Surrogate
from studies.opening import sizes
from studies.results.choice import Choice
from studies.results.planned import Planned
from studies.words.console import Console

if TYPE_CHECKING:
    import pandas as pd


class ChoiceResult(Result[Choice]):
    """Model structures compared on one measurement."""

    @property
    def chosen(self) -> str:
        """Name of the case that the data choose; empty where they do not decide."""
        return self.outcome.result.chosen

    @property
    def reason(self) -> str:
        """Why, in words."""
        return self.outcome.result.reason

    @cached_property
    def table(self) -> "pd.DataFrame":
        """A row per structure: error, criteria, evidence, probability, left-out error, calls."""
        import pandas as pd

        return pd.DataFrame([vars(one) for one in self.outcome.result.structures]).set_index("case")


@verb
def choose(
    cases: Sequence[str | Path | HasPath],
    *,
    noise: Noise = "correlated",
    max_calls: int | None = None,
    max_hours: float | None = None,
    again: bool = False,
    profile: str | Path = "quick",
    window: str | tuple[float, float] | None = None,
    seed: int | None = None,
    retry_failed: bool = False,
    jobs: int | None = None,
    dask: str | None = None,
    storage: str | None = None,
    tracking: str | None = None,
    console: Console | None = None,
) -> ChoiceResult:
    """Compare model structures on one measurement, as `studies choose`.

    Args:
        cases: Two or more cases that are compared with the same samples: names, files, folders, `Case`
            objects that were read, or `Problem` objects.
        noise: Model of the residuals of the best structure, which is used for all.
        max_calls: Most simulations of the calibration of each; None for 100.
        max_hours: No simulation begins later; the same call continues. [h]
        again: Compare again though it is finished; calibrations are not repeated.
        profile: Budget: "quick", "thorough", "paper", or a profile file.
        window: Part of the recording: two days, or a text as "0-10" or "2-8h"; None for the cases' own.
        seed: Seed of all random numbers; None for the profile's.
        retry_failed: Simulate failed simulations again.
        jobs: Processes; None for the number of cores.
        dask: Address of a Dask scheduler whose workers simulate; None for this machine.
        storage: PostgreSQL database of Optuna and MLflow; None for $STUDIES_STORAGE, else files in mlruns.
        tracking: MLflow server that runs are also sent to, or "local"; None for $MLFLOW_TRACKING_URI.
        console: Shows progress; None for standard error.

    Returns:
        What speaks for each structure, and which one the data choose.

    Raises:
        InputError: A case, a keyword or a file is wrong, or the cases are compared with other samples.
        StageError: A stage failed.
    """
    given = {name: value for name, value in locals().items() if name not in ("cases", "noise", "again")}
    from studies.api.calibrations import calibrate
    from studies.stages.choose_stage import check_same_measurement, choose_stage

    # Before anything is simulated.
    check_same_measurement([opened("choose", given | {"case": case}).case for case in cases])
    found = [calibrate(case, **given) for case in cases]
    tasks, outcomes = [one.task for one in found], [one.outcome for one in found]
    return ChoiceResult(tasks[0], choose_stage(tasks, outcomes, noise=noise, again=again))


class NextResult(Result[Planned]):
    """Candidates for the next experiment, ranked."""

    @cached_property
    def table(self) -> "pd.DataFrame":
        """A row per candidate, the best first: days, what intervals shrink to, what it would determine."""
        import pandas as pd

        return pd.DataFrame([vars(one) for one in self.outcome.result.candidates]).set_index("name")

    @cached_property
    def half_widths(self) -> "pd.DataFrame":
        """Half of the 90 % intervals, a row per parameter, a column for now and each candidate. [1]."""
        import pandas as pd

        found = self.outcome.result
        columns = {one.name: one.half_widths for one in found.candidates}
        return pd.DataFrame({"now": found.half_widths, **columns}).rename_axis("parameter")


@verb
def next_experiment(
    case: str | Path | HasPath = "office",
    *,
    inputs: Sequence[str | Path] | None = None,
    vary: Sequence[str] | None = None,
    output: Sequence[str] | None = None,
    criterion: Criterion = "half-widths",
    method: Method | None = None,
    n_train: int | None = None,
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
) -> NextResult:
    """Rank measurements by what they would show of the parameters, as `studies next`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        inputs: CSV files of inputs, or folders of such files: an experiment each.
        vary: Inputs that may be set, as "q1=0:1500" in the unit of the case file.
        output: Outputs that may be measured too, as "TWall=0.1" with the uncertainty in the FMU's unit.
        criterion: "half-widths" of the intervals, "A" or "D" for A- and D-optimal experiments.
        method: Method of the calibration; None for adaptive if there is one.
        n_train: The calibration with this training-set size; None for the best.
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
        The candidates, the best first.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    task = opened("next_experiment", locals())
    from studies.stages.candidates import offers
    from studies.stages.next_stage import next_stage
    from studies.stages.uncertainty_stage import calibration_to_judge

    calibration = calibration_to_judge(task, method, sizes(n_train))
    present, offered = offers(task, [Path(one) for one in inputs or ()], vary or (), output or ())
    return NextResult(task, next_stage(task, calibration, present, offered, criterion=criterion, again=again))
