"""What MLflow shows of the stages that are not tuning: numbers, curves and pictures."""

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simulation.errors import MachineError
from studies.calibration.sobol import SobolIndices
from studies.reporting.drawing import Figure, write_picture
from studies.reporting.figures_calibration import (
    band_figure,
    calibration_figure,
    calls_figure,
    interval_figure,
    planned_figure,
    profile_figure,
)
from studies.results.choice import Choice
from studies.results.outcome import Outcome
from studies.results.planned import Planned
from studies.results.profiled import Profiles
from studies.results.saved import plain
from studies.results.stage_results import Calibration, Prediction, Reported, Uncertainty
from studies.task import Task
from studies.tracking.origin import environment
from studies.tracking.study_tags import PARENT


def log_calibration(task: Task, outcome: Outcome[Calibration]) -> None:
    """Log a finished calibration, with its figures."""
    found = outcome.result
    tags: dict[str, Any] = {"method": found.method, "stop_reason": found.stop_reason}
    tags["error"] = found.error_name
    metrics: dict[str, float | None] = {
        "mse/calibrated": found.mse,
        "calls/paper": found.n_calls_paper,
        "calls/all": found.n_calls,
        "calls/rounds": found.n_rounds,
        "calls/warm_start": found.n_warm_start,
    }
    if found.state_equations is not None:
        metrics["calls/by_state_equations"] = found.state_equations.n_calls
    if found.validation is not None:
        metrics["mse/validation"] = found.validation.final.mse
    if (screened := found.screening) is not None:
        tags |= {"surrogate_study": screened.study, "surrogate_trial": screened.trial}
        metrics |= {
            "mse/surrogate": screened.mse_surrogate,
            "mse/screened": screened.mse,
            "mse/screening_gap": screened.gap,
            "calls/polish": found.ledger["n_polish"],
            # Not under the names of a trial's own: who looks for the least error looks for trials.
            **{f"surrogate/{name}": error for name, error in screened.errors.items()},
        }
    curve = zip(found.history_calls.tolist(), found.history_mse.tolist(), strict=True)
    _log(
        task,
        outcome,
        "calibration",
        name=f"{outcome.name} calibration",
        params={"n_train": found.n_train, "seed": found.seed, **found.settings},
        metrics=metrics,
        curves={"mse/over_calls": [(int(n), mse) for n, mse in curve if np.isfinite(mse)]},
        tags=tags,
        pictures={
            "calibration": calibration_figure(task.case, found),
            "convergence": calls_figure(task.case, found),
        },
    )


def log_uncertainty(task: Task, outcome: Outcome[Uncertainty]) -> None:
    """Log a finished uncertainty, with its figures."""
    found = outcome.result
    known = Counter(one.known for one in found.parameters.values())
    _log(
        task,
        outcome,
        "uncertainty",
        name=f"{outcome.name} uncertainty",
        params={
            "noise": found.noise.kind,
            "max_calls": found.max_calls,
            "seed": found.seed,
            "level": found.level,
        },
        metrics={
            "sample/n": found.sample.n,
            "sample/n_effective": found.sample.n_effective,
            "calls/all": found.ledger.total,
            "parameters/determined": known["determined"],
        },
        tags={"calibration": found.calibration},
        pictures={
            "bands": band_figure(task.case, found),
            "intervals": interval_figure(task.case.parameter_space, found),
        },
    )


def log_sensitivity(task: Task, outcome: Outcome[SobolIndices]) -> None:
    """Log Sobol indices, averaged over time."""
    found = outcome.result
    orders = ("first_order", "total_order")
    metrics = {
        f"{order}/{name}": value
        for name, means in found.mean.items()
        for order, value in zip(orders, means, strict=True)
    }
    asked = "FMU" if found.n_train is None else f"surrogate, n_train = {found.n_train}"
    params = {"model": asked, "n_base": found.n_base, "seed": task.profile.seed}
    _log(task, outcome, "sensitivity", params=params, metrics=metrics)


def log_prediction(task: Task, outcome: Outcome[Prediction]) -> None:
    """Log a calibrated model with other inputs: its table and its picture."""
    found, root = outcome.result, task.paths.root
    table = root / found.table
    _log(
        task,
        outcome,
        "prediction",
        params={"inputs": found.inputs},
        metrics={"sample/n": found.n_sample},
        tags={"calibration": found.calibration},
        images=[one for one in [table.with_suffix(".png")] if one.is_file()],
        artifacts=[table],
    )


def log_profiles(task: Task, outcome: Outcome[Profiles]) -> None:
    """Log profile likelihoods, with their picture."""
    found = outcome.result
    pictures = {"profiles": profile_figure(found)}
    metrics = {"calls/all": found.n_calls}
    _log(task, outcome, "profiles", params={"level": found.level}, metrics=metrics, pictures=pictures)


def log_planned(task: Task, outcome: Outcome[Planned]) -> None:
    """Log candidates for the next experiment, with their picture and the tables of the best one."""
    found, root = outcome.result, task.paths.root
    best = found.candidates[0]
    _log(
        task,
        outcome,
        "next",
        params={"criterion": found.criterion, "points": found.n_points},
        metrics={"calls/all": found.n_calls, "shrinks_to": best.shrinks_to},
        tags={"calibration": found.calibration, "best": "" if best.excluded else best.name},
        artifacts=[root / place for place in (found.block, found.inputs) if place],
        pictures={"candidates": planned_figure(found)},
    )


def log_choice(task: Task, outcome: Outcome[Choice]) -> None:
    """Log compared structures: a run of the comparison, and below it one of each structure."""
    found, name = outcome.result, outcome.stage
    params = {"noise": found.noise.kind, "seed": task.profile.seed}
    parent = _log(
        task, outcome, "choice", params=params, tags={"chosen": found.chosen, "reason": found.reason}
    )
    # As late as in `_log`.
    from studies.tracking.runs import log_stage

    for one in found.structures:
        numbers = {key: value for key, value in plain(one).items() if isinstance(value, int | float)}
        params = {"calibration": one.label, "n_parameters": numbers.pop("n_parameters")}
        about = {"key": f"{outcome.digest}-{one.case}", "wall_s": outcome.wall_s, "tags": {PARENT: parent}}
        log_stage(task, "structure", f"{name}: {one.case}", params=params, metrics=numbers, **about)


def log_report(task: Task, outcome: Outcome[Reported]) -> None:
    """Log a report: its page, which holds its figures."""
    _log(task, outcome, "report", artifacts=[task.paths.root / outcome.result.index])


def _log(
    task: Task,
    outcome: Outcome[Any],
    kind: str,
    *,
    name: str = "",
    artifacts: Sequence[Path] = (),
    images: Sequence[Path] = (),
    pictures: Mapping[str, Figure] | None = None,
    **more: Any,
) -> str:
    """Log what every stage has, and more; return the run's id."""
    # MLflow takes seconds to import, which a stage that is finished does without.
    from studies.tracking.runs import log_stage

    arrays = task.results / f"{outcome.stage}.npz"
    made = {**outcome.provenance, "environment": environment(), "result": plain(outcome.result)}
    with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
        drawn = list[Path]()
        for picture, figure in (pictures or {}).items():
            try:
                file = Path(scratch) / f"{picture}.svg"
                drawn.append(write_picture(figure, file, footnote=task.label))
            except MachineError as error:
                task.console.warn(f"{outcome.stage}: {picture}: {error}; the result is complete without it")
        return log_stage(
            task,
            kind,
            name or outcome.stage,
            key=outcome.digest,
            wall_s=outcome.wall_s,
            figures=[*images, *drawn],
            artifacts=[*artifacts, *([arrays] if arrays.is_file() else [])],
            record=made if outcome.provenance else None,
            **more,
        )
