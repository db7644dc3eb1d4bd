"""`calibrate`, and what a calibration came to."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simulation.errors import InputError
from studies.api.verb import HasPath, opened, verb
from studies.keywords import Method, Noise, Surrogate
from studies.opening import sizes
from studies.results.outcome import Outcome
from studies.results.stage_results import Calibration
from studies.words.console import Console
from studies.words.wording import axis_label, ended, quantity, square_of

if TYPE_CHECKING:
    import pandas as pd

    from studies.api.judgements import PredictionResult, UncertaintyResult
    from studies.task import Task


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """A finished calibration. A notebook shows it as a table.

    Attributes:
        task: Case, profile and project.
        stages: What each stage came to, in order.
        outcome: The calibration of least error among them.
    """

    task: "Task"
    stages: tuple[Outcome[Any], ...]
    outcome: Outcome[Calibration]

    @property
    def name(self) -> str:
        """By which `studies best` and `studies reproduce` know it, such as "office-quick/adaptive"."""
        return f"{self.task.label}/{self.outcome.name}"

    @cached_property
    def theta(self) -> "pd.DataFrame":
        """Parameters by name, with the columns value, unit, lower, upper and determined. Shape (p, 5).

        The last one is False where the data leave a parameter open, and None where that was not judged.
        """
        import pandas as pd

        space, judged = self.task.case.parameter_space, self.outcome.result.determined_by_data
        columns = {
            "value": self.outcome.result.theta,
            "unit": self.outcome.result.units,
            "lower": space.named(space.lower),
            "upper": space.named(space.upper),
            "determined": {name: judged and name not in judged.open for name in space.names},
        }
        return pd.DataFrame(columns).rename_axis("parameter")

    @property
    def mse(self) -> float:
        """Final error. [first output's unit squared]."""
        return self.outcome.result.mse

    @property
    def error_name(self) -> str:
        """What it is: "MSE", "mean loss" with a robust loss, "whitened MSE" with a correlation time."""
        return self.outcome.result.error_name

    @property
    def calls(self) -> int:
        """Model calls in all. Those that were stored before count too."""
        return self.outcome.result.n_calls

    @property
    def converged(self) -> bool:
        """Whether a tolerance, or the target, ended it."""
        return self.outcome.result.converged

    @property
    def reason(self) -> str:
        """Why it ended."""
        return self.outcome.result.stop_reason

    @property
    def note(self) -> str:
        """What the case file says must stand beside its numbers; empty for nothing."""
        return self.task.case.note

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each output by its name."""
        return {output.name: output.unit for output in self.task.case.outputs}

    @property
    def numbers(self) -> Mapping[str, Any]:
        """All that the command says of it with `--json`."""
        return self.outcome.to_dict(self.task.paths)

    @cached_property
    def trajectories(self) -> "pd.DataFrame":
        """Outputs over time: the columns (output, "measured") and (output, "calibrated"). Shape (t, 2 k).

        The index is the time of the case file in seconds; NaN where nothing was measured. [per output]
        """
        import pandas as pd

        case, y = self.task.case, self.outcome.result.y
        at, series = case.measurement.time, dict[tuple[str, str], "pd.Series[float]"]()
        every = np.unique(np.concatenate([at, *(output.samples.time for output in case.outputs)]))
        for k, output in enumerate(case.outputs):
            if output.is_measured:
                series[output.name, "measured"] = pd.Series(
                    output.samples.beside(at, y[:, k]), output.samples.time
                )
            series[output.name, "calibrated"] = pd.Series(np.interp(every, at, y[:, k]), every)
        return pd.DataFrame(series).rename_axis("time_s")

    def plot(self) -> Any:
        """Draw measured and calibrated outputs over time, one panel per output.

        Returns:
            Matplotlib's axes, as pandas does. Shape (k,).
        """
        from simulation.time_unit import unit_for

        unit = unit_for(float(self.trajectories.index[-1]))
        drawn = self.trajectories.set_axis(unit.of_seconds(self.trajectories.index.to_numpy()))
        drawn.columns = [" ".join(column) for column in drawn.columns]
        pairs = [(f"{name} measured", f"{name} calibrated") for name in self.units]
        panels = drawn.plot(
            subplots=pairs,
            style={measured: "." for measured, _ in pairs},
            figsize=(9, 3.2 * len(pairs)),
            xlabel=f"time [{unit.symbol}]",
        )
        for axes, (name, of) in zip(panels, self.units.items(), strict=True):
            axes.set_ylabel(axis_label(name, of))
        return panels

    def uncertainty(
        self,
        *,
        noise: Noise = "correlated",
        max_calls: int | None = None,
        profiles: bool = False,
        again: bool = False,
    ) -> "UncertaintyResult":
        """Say how sure it is, as `studies.uncertainty`.

        Args:
            noise: Model of the residuals.
            max_calls: Most simulations; None for 20 per parameter, at least 100.
            profiles: Follow the profile likelihoods too.
            again: Repeat it if it is finished.
        """
        from studies.api.judgements import uncertainty_of

        return uncertainty_of(
            self.task, self.outcome, noise=noise, max_calls=max_calls, profiles=profiles, again=again
        )

    def predict(
        self, inputs: "str | Path | pd.DataFrame | None" = None, *, experiment: str | None = None
    ) -> "PredictionResult":
        """Simulate the calibrated model with other inputs, as `studies.predict`.

        Args:
            inputs: A CSV file, a folder of such files, or a frame, with the columns of the case's inputs.
            experiment: The experiment to simulate, of a case with several.
        """
        from studies.api.judgements import prediction_of

        return prediction_of(self.task, self.outcome, inputs, experiment)

    def write(self, file: str | Path, *, experiment: str | None = None) -> Path:
        """Write the calibrated values to a new file, in the format of its ending.

        Args:
            file: Ends with .ssv, .mo, .csv, .json or .fmu.
            experiment: The experiment whose values are written, of a case with several.

        Returns:
            The file.

        Raises:
            InputError: The file exists, or the ending names no format.
        """
        from studies.exports.written_file import write_values
        from studies.project import FinishedCalibration

        finished = FinishedCalibration.of(self.task.paths, self.task.label, self.outcome)
        return write_values(self.task.paths, finished, Path(file), experiment)

    def __repr__(self) -> str:
        """Return the error, the cost, and the parameters as a table."""
        return "\n".join([*self._sentences(), self.theta.to_string(float_format="{:.6g}".format)])

    def _repr_html_(self) -> str:
        sentences = "<br>".join(map(escape, self._sentences()))
        return f"<p>{sentences}</p>{self.theta.to_html(float_format='{:.6g}'.format)}"

    def _sentences(self) -> Iterator[str]:
        unit = square_of(next(iter(self.units.values())))
        error = f"{self.error_name} {quantity(self.mse, unit, 4)}"
        how = ended(self.reason, converged=self.converged)
        yield f"{self.name}: {error} after {self.calls} model calls. {how}"
        if self.note:
            yield f"Note: {self.note}"


@verb
def calibrate(
    case: str | Path | HasPath = "office",
    *,
    method: Method | None = None,
    n_train: int | Sequence[int] | None = None,
    max_calls: int | None = None,
    max_hours: float | None = None,
    parallel: int | None = None,
    target: float | None = None,
    from_stored: bool | None = None,
    state_equations: bool | None = None,
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
) -> CalibrationResult:
    """Find the parameters that fit the measurement best, as `studies calibrate`.

    Args:
        case: Name, file or folder of a case, a `Case` that was read, or a `Problem`.
        method: "adaptive" needs no training set; "paper" screens on the surrogate and polishes on the FMU.
            None for adaptive, or for paper where `n_train` is given.
        n_train: Training-set sizes of the paper's method; None for all that have a surrogate.
        max_calls: Most simulations of an adaptive calibration (None: 100) or of one polish (None: the
            profile's).
        max_hours: No simulation begins later; the same call continues. [h]
        parallel: Simulations per round of an adaptive calibration; None for 1.
        target: Error until which an adaptive calibration goes on. [first output's unit squared]
        from_stored: Whether an adaptive calibration begins with the stored simulations of this model; None
            for those of a check.
        state_equations: Whether it learns state equations; None for yes if the FMU gives its states.
        again: Repeat what is finished.
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
        The calibration; with several sizes in `n_train` the one of least error.

    Raises:
        InputError: The case, a keyword or a file is wrong.
        StageError: A stage failed.
    """
    given = locals()
    is_by_paper = method == "paper" or bool(sizes(n_train))
    if method == "adaptive" and sizes(n_train):
        raise InputError(
            "--n-train belongs to --method paper; the adaptive method has no training set, remove --n-train"
        )
    for name in ("parallel", "from_stored", "state_equations", "target") if is_by_paper else ():
        if given[name] not in (None, False) or (name == "state_equations" and given[name] is not None):
            option = f"--{'no-' if given[name] is False else ''}{name.replace('_', '-')}"
            raise InputError(
                f"{option} belongs to --method adaptive; remove it, or remove --n-train and --method"
            )
    task = opened("calibrate", given)
    from studies.doctor.begin import say_begin

    say_begin(task.case, task.console)
    if is_by_paper:
        from studies.stages.calibrate_stage import calibrate_stage, tuned_with_best

        tuned = tuned_with_best(task, sizes(n_train))
        return best_of(task, [calibrate_stage(task, n, again=again) for n in tuned])
    from studies.stages.adaptive_stage import adaptive_stage

    outcome = adaptive_stage(
        task,
        max_calls=max_calls,
        n_parallel=parallel or 1,
        target_mse=target,
        from_stored=from_stored,
        state_equations=state_equations,
        again=again,
    )
    return best_of(task, [outcome])


def best_of(task: "Task", outcomes: Sequence[Outcome[Any]]) -> CalibrationResult:
    """Return the calibration of least error among those that stages left.

    Args:
        task: The task.
        outcomes: What its stages came to.
    """
    calibrations = [one for one in outcomes if isinstance(one.result, Calibration)]
    return CalibrationResult(task, tuple(outcomes), min(calibrations, key=lambda one: one.result.mse))
