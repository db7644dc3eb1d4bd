"""What MLflow's pages say in words: the answer first, then the table behind it. Markdown."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from studies.report.wording import MISSING, count, difference_unit, quantity, significant, squared
from studies.tracking.mlflow_view import STAGES, TRIALS, run_address, view_address
from studies.tuning.study_spec import StudySpec, StudySummary


@dataclass(frozen=True)
class SizeResult:
    """What is known of one training-set size.

    Args:
        n_train: training-set size.
        run_id: MLflow run of the study.
        status: status of that run.
        best_run_id: run of the best trial, empty without one.
        best_trial: the best trial's index.
        validation_mae: its error on the validation set. [first output's unit]
        test_mae: its error on the test set. [first output's unit]
        test_p90: 90th percentile over the test set. [first output's unit]
        default_mae: test error of the default configuration. [first output's unit]
        n_trials: finished trials.
        n_pruned: trials stopped early.
        n_failed: trials that failed.
        tuning_h: training time of all trials. [h]
        calibration_run_id: newest calibration with this surrogate, empty without one.
        mse: error of the calibrated model. [square of the first output's unit]
        n_calls: model calls in all, for the surrogate and the calibration.
    """

    n_train: int
    run_id: str
    status: str
    best_run_id: str
    best_trial: str
    validation_mae: float
    test_mae: float
    test_p90: float
    default_mae: float
    n_trials: int
    n_pruned: int
    n_failed: int
    tuning_h: float
    calibration_run_id: str = ""
    mse: float = math.nan
    n_calls: float = math.nan

    @property
    def gain_percent(self) -> float:
        """How much smaller the error is than that of the default configuration. [%]."""
        return gain_percent(self.test_mae, self.default_mae)


def gain_percent(tuned: float, default: float) -> float:
    """Return how much smaller the tuned error is. [%]."""
    return 100.0 * (1.0 - tuned / default) if default > 0 else math.nan


def answer(sizes: Sequence[SizeResult], unit: str) -> str:
    """Say in one or two sentences which model is best for which n, and whether tuning was worth it."""
    known = [size for size in sizes if math.isfinite(size.test_mae)]
    if not known:
        return "No trial is complete yet."
    errors = ", ".join(f"n = {size.n_train}: **{significant(size.test_mae)}**" for size in known)
    text = f"Best test error [{unit or '1'}] for {errors}."
    gains = [size.gain_percent for size in known if math.isfinite(size.gain_percent)]
    hours = sum(size.tuning_h for size in sizes)
    if gains:
        low, high = round(min(gains)), round(max(gains))
        spread = f"{low} %" if low == high else f"{low} to {high} %"
        text += f" Tuning lowered it by {spread} against the default configuration, in {_hours(hours)}."
    calibrated = [size for size in known if math.isfinite(size.mse)]
    if calibrated:
        best = min(calibrated, key=lambda size: size.mse)
        text += (
            f" The best calibration (n = {best.n_train}) leaves an MSE of "
            f"**{quantity(best.mse, squared(unit))}** after {count(best.n_calls, 'model call')}."
        )
    return text


def size_table(sizes: Sequence[SizeResult], unit: str, experiment: str) -> str:
    """Return the table behind the answer, a row per size, with links to the runs."""
    error = f" [{unit}]" if unit else ""
    square = f" [{squared(unit)}]" if unit else ""
    heads = [
        "n",
        "best trial",
        f"val MAE{error}",
        f"test MAE{error}",
        f"test p90{error}",
        f"default MAE{error}",
    ]
    heads += ["gain", "trials", "pruned", "failed", "hours", f"calibrated MSE{square}", "calls"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---:|" * len(heads)]
    for size in sizes:
        trial = f"trial {size.best_trial}" if size.best_run_id else MISSING
        cells = [
            _link(str(size.n_train), experiment, size.run_id),
            _link(trial, experiment, size.best_run_id),
            significant(size.validation_mae),
            f"**{significant(size.test_mae)}**",
            significant(size.test_p90),
            significant(size.default_mae),
            f"{round(size.gain_percent)} %" if math.isfinite(size.gain_percent) else MISSING,
            str(size.n_trials),
            str(size.n_pruned),
            str(size.n_failed),
            f"{size.tuning_h:.2f}",
            _link(significant(size.mse), experiment, size.calibration_run_id),
            count(size.n_calls) if math.isfinite(size.n_calls) else MISSING,
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def overview_note(sizes: Sequence[SizeResult], *, unit: str, experiment: str) -> str:
    """Return the answer and the table behind it."""
    return f"{answer(sizes, unit)}\n\n{size_table(sizes, unit, experiment)}"


def experiment_note(overview: str, *, picture: str, unit: str, case: str, note: str, experiment: str) -> str:
    """Return an experiment's description. Only this page has room for a picture.

    Args:
        overview: the overview run's note.
        picture: where the page finds the picture of all trials, empty without one.
        unit: unit of the errors.
        case: name of the case.
        note: the case's note.
        experiment: id of the experiment.
    """
    links = [
        f"[all trials in charts]({view_address(experiment, TRIALS, charts=True)})",
        f"[all trials in a table]({view_address(experiment, TRIALS)})",
        f"[calibrations, sensitivities, reports]({view_address(experiment, STAGES)})",
    ]
    words = (
        f"PELS-VAE surrogates of the case **{case}**. A run per study (one training-set size n), its trials "
        "below it. `test/mae` is the mean absolute error over the test set"
        f"{f' in {unit}' if unit else ''}, `p90` the 90th percentile over its simulations, `best/…` on a "
        "study its best trial by validation error, `gain_percent` that trial's test error against the "
        "default configuration's, `calibrated/…` the newest calibration with that surrogate. FINISHED means "
        "complete, KILLED pruned or interrupted, FAILED has its `reason` as a tag."
    )
    shown = f"![Error of all trials over n]({picture})" if picture else ""
    parts = [overview, "More: " + " · ".join(links), shown, words, note]
    return "\n\n".join(part for part in parts if part)


def study_note(spec: StudySpec, best: str = "", pictures: Mapping[str, str] | None = None) -> str:
    """Return a study's description.

    Args:
        spec: the study.
        best: what is said of its best trial.
        pictures: links to its pictures by their names.
    """
    text = (
        f"Surrogates trained on the first {spec.n_train} simulations of the design, searched from the "
        f"variant `{spec.variant}`. Optuna study `{spec.name}`. Its trials are the runs below it."
    )
    links = " · ".join(f"[{name}]({place})" for name, place in (pictures or {}).items())
    return "\n\n".join(part for part in (best, f"Pictures: {links}" if links else "", text) if part)


def best_sentence(summary: StudySummary, default: float, output_unit: str) -> str:
    """Say how good the best trial is, also against the default configuration."""
    unit, errors = difference_unit(output_unit), summary.best_metrics
    tuned, p90 = (errors.get(name, math.nan) for name in ("test/mae", "test/p90"))
    text = f"Trial {summary.best_index} is best: test MAE **{quantity(tuned, unit)}**, "
    text += f"90th percentile {quantity(p90, unit)}"
    gain = gain_percent(tuned, default)
    if math.isfinite(gain) and round(gain) != 0:
        more = "below" if gain > 0 else "above"
        text += f", {abs(gain):.0f} % {more} the default configuration's {quantity(default, unit)}"
    return text + "."


def study_numbers(summary: StudySummary, default: float) -> dict[str, float]:
    """Return what a study came to, in numbers that a table has room for; the trials' own are whole.

    Args:
        summary: the study.
        default: test error of the default configuration, NaN where it is not known.
    """
    best = summary.best_metrics
    numbers: dict[str, float] = {
        "n_train": summary.n_train,
        "n_trials": summary.n_trials,
        "n_complete": summary.n_complete,
        "n_pruned": summary.n_pruned,
        "n_failed": summary.n_failed,
        "train_wall_s": round(summary.wall_s, 1),
        "tuning_h": round(summary.wall_s / 3600.0, 4),
        **{f"best/{name}": rounded(value) for name, value in best.items()},
        "default/test/mae": rounded(default),
        "gain_percent": round(gain_percent(best.get("test/mae", math.nan), default), 1),
    }
    return {name: float(value) for name, value in numbers.items() if math.isfinite(value)}


def rounded(value: float) -> float:
    """Return a number with as many digits as a table has room for."""
    return float(f"{value:.4g}")


def _link(text: str, experiment: str, run_id: str) -> str:
    return f"[{text}]({run_address(experiment, run_id)})" if run_id else text


def _hours(hours: float) -> str:
    return f"{60.0 * hours:.1f} minutes of training" if hours < 1 else f"{hours:.1f} hours of training"
