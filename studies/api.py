"""The commands as functions, for scripts and notebooks: `run`, `tune`, `calibrate`, and `load_case`.

Each function takes the words of its command as keywords and does what the command does: the same stages, the
same numbers, the same files. What is finished is reused, and what was interrupted goes on.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from simulation.case import Case
from simulation.case import load_case as load_case_file
from simulation.time_unit import unit_for
from studies.cli import build_parser, check_surroundings, command_module
from studies.paths import find_case, find_project
from studies.results.outcome import Outcome
from studies.results.stage_results import Calibration
from studies.task import StageError, Task
from studies.words.console import Console
from studies.words.wording import axis_label, quantity, square_of


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """A finished calibration. A notebook shows it as a table.

    Attributes:
        name: By which `studies best` and `studies reproduce` know it, such as "office-quick/adaptive".
        theta: Parameters by name, with the columns value, unit, lower, upper and determined. The last one is
            False where the data leave a parameter open, and None where that was not judged. Shape (p, 5).
        mse: Final error. [first output's unit squared]
        error_name: What it is: "MSE", "mean loss" with a robust loss, "whitened MSE" with a correlation time.
        calls: Model calls in all. Those that were stored before count too.
        trajectories: The columns (output, "measured") and (output, "calibrated") of each output. The index is
            the time of the case file in seconds; NaN where nothing was measured. Shape (t, 2 k). [per output]
        units: Unit of each output by its name.
        reason: Why it ended.
        note: What the case file says must stand beside its numbers; empty for nothing.
        numbers: All that the command says of it with `--json`.
    """

    name: str
    theta: pd.DataFrame
    mse: float
    error_name: str
    calls: int
    trajectories: pd.DataFrame
    units: Mapping[str, str]
    reason: str
    note: str
    numbers: Mapping[str, Any]

    def plot(self) -> Any:
        """Draw measured and calibrated outputs over time, one panel per output.

        Returns:
            Matplotlib's axes, as pandas does. Shape (k,).
        """
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

    def __repr__(self) -> str:
        """Return the error, the cost, and the parameters as a table."""
        return "\n".join([*self._sentences(), self.theta.to_string(float_format="{:.6g}".format)])

    def _repr_html_(self) -> str:
        said = "<br>".join(map(escape, self._sentences()))
        return f"<p>{said}</p>{self.theta.to_html(float_format='{:.6g}'.format)}"

    def _sentences(self) -> Iterator[str]:
        unit = square_of(next(iter(self.units.values())))
        error = f"{self.error_name} {quantity(self.mse, unit, 4)}"
        yield f"{self.name}: {error} after {self.calls} model calls; it ended because {self.reason}"
        if self.note:
            yield f"Note: {self.note}"


def run(case: str | Path = "office", **options: Any) -> CalibrationResult:
    """Do all stages of a study in order, as `studies run`, and skip finished ones.

    Args:
        case: Name, file or folder of a case.
        options: Those of the command line: `n_train=[32, 64]` is `--n-train 32 64`.

    Returns:
        The calibration of least error. `calibrate(case, n_train=64)` then returns that of a size, and
        `tune(case)` the best model of each size.

    Raises:
        InputError: The case, an option or a file is wrong.
        StageError: A stage failed, or `studies check` found errors.
    """
    return _best_of(*_done("run", case, options))


def tune(case: str | Path = "office", **options: Any) -> pd.DataFrame:
    """Tune one surrogate per training-set size with Optuna, as `studies tune`.

    Args:
        case: Name, file or folder of a case.
        options: Those of the command line: `n_train=[32, 64]` is `--n-train 32 64`.

    Returns:
        A row per size with the fields of `studies best --json`, among them the hyperparameters `params`, the
        test errors `mae` and `p90`, and the `model_uri` by which MLflow loads the model.

    Raises:
        InputError: The case, an option or a file is wrong.
        StageError: A stage failed.
    """
    _, outcomes = _done("tune", case, options)
    return pd.DataFrame(map(asdict, outcomes[-1].result.studies)).set_index("n_train")


def calibrate(case: str | Path = "office", **options: Any) -> CalibrationResult:
    """Find the parameters that fit the measurement best, as `studies calibrate`.

    Args:
        case: Name, file or folder of a case.
        options: Those of the command line: `max_calls=60` is `--max-calls 60`.

    Returns:
        The calibration; with several sizes in `n_train` the one of least error.

    Raises:
        InputError: The case, an option or a file is wrong.
        StageError: A stage failed.
    """
    return _best_of(*_done("calibrate", case, options))


def load_case(case: str | Path = "office") -> Case:
    """Read a case of the project or an embedded one.

    Args:
        case: Name, file or folder of a case.

    Raises:
        InputError: There is none, or something in its files is wrong.
    """
    return load_case_file(find_case(find_project(None), str(case)))


def _done(command: str, case: str | Path, options: Mapping[str, Any]) -> tuple[Task, list[Outcome[Any]]]:
    """Do a command in this process and return its study and what its stages came to."""
    words = [command, str(case), *_words(command, options)]
    chosen = build_parser().parse_args(words)
    chosen.typed = shlex.join(["studies", *words])
    console = _Listener(quiet=chosen.quiet)
    check_surroundings()
    code = command_module(command).run(chosen, console)
    ((task, outcomes),) = console.done
    if code:
        raise StageError(f"{task.label}: studies check {case} found errors; type it, it says which")
    return task, outcomes


def _words(command: str, options: Mapping[str, Any]) -> Iterator[str]:
    """Give keywords as the words of the command line."""
    known = vars(build_parser().parse_args([command])).keys() - {"command", "case", "json", "dry_run"}
    for name, value in options.items():
        if name not in known:
            raise TypeError(f"{command}() got an unexpected keyword argument {name!r}")
        option = name.replace("_", "-")
        if value is False and name == "state_equations":
            yield f"--no-{option}"
        elif value is True:
            yield f"--{option}"
        elif isinstance(value, (list, tuple)):
            yield from (f"--{option}", *map(str, value))
        elif value is not None and value is not False:
            yield f"--{option}={value}"


def _best_of(task: Task, outcomes: Sequence[Outcome[Any]]) -> CalibrationResult:
    """Return the calibration of least error among those that a command left."""
    calibrations = [one for one in outcomes if isinstance(one.result, Calibration)]
    outcome: Outcome[Calibration] = min(calibrations, key=lambda one: one.result.mse)
    case, found, series = task.case, outcome.result, dict[tuple[str, str], "pd.Series[float]"]()
    at, judged, space = case.measurement.time, found.determined_by_data, case.parameter_space
    every = np.unique(np.concatenate([at, *(one.samples.time for one in case.outputs)]))
    for k, one in enumerate(case.outputs):
        if one.is_measured:
            series[one.name, "measured"] = pd.Series(one.samples.values, one.samples.time)
        series[one.name, "calibrated"] = pd.Series(np.interp(every, at, found.y[:, k]), every)
    theta = pd.DataFrame(
        {
            "value": found.theta,
            "unit": found.units,
            "lower": space.named(space.lower),
            "upper": space.named(space.upper),
            "determined": {name: judged and name not in judged.open for name in space.names},
        }
    )
    return CalibrationResult(
        name=f"{task.label}/{outcome.name}",
        theta=theta.rename_axis("parameter"),
        mse=found.mse,
        error_name=found.error_name,
        calls=found.n_calls,
        trajectories=pd.DataFrame(series).rename_axis("time_s"),
        units={output.name: output.unit for output in case.outputs},
        reason=found.stop_reason,
        note=case.note,
        numbers=outcome.to_dict(task.paths),
    )


@dataclass(frozen=True)
class _Listener(Console):
    """Keeps what a command came to."""

    as_json: bool = True
    done: list[Any] = field(default_factory=list)

    def document(self, content: dict[str, Any], of: Any = None) -> None:
        self.done.append(of)
