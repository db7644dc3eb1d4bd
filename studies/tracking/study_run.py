"""A study as MLflow shows it: a run above those of its trials, its best surrogate in the registry."""

import logging
import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optuna

from simulation.errors import MachineError
from studies.reporting.drawing import write_picture
from studies.reporting.figures_tuning import study_figure
from studies.results.declaration import Declaration, StudyDeclaration
from studies.tracking.leaderboard import GAIN, JUDGED_BY, SEARCHED, set_views
from studies.tracking.quiet_mlflow import entities
from studies.tracking.runs import CURVE, SURROGATE, VALIDATION_MAE, RunStore, register_best
from studies.tracking.study_tags import NOTE, PARENT, with_line
from studies.tracking.trial_run import end_run
from studies.words.wording import count, difference_unit, percent, quantity, setting

if TYPE_CHECKING:
    from studies.results.trials import TrialView, TunedStudy

PROMOTED = "promoted"
"""Tag of a model's version: why it took the place of another one."""
_LOG = logging.getLogger(__name__)
_BEST_TRIAL = "Best trial"
BEST = "best"
"""Tag of the run of the best trial of a training-set size: `tags.best = 'yes'` is the leaderboard."""


def open_study_run(runs: RunStore, spec: StudyDeclaration, n_trials: int, run_id: str | None) -> str:
    """Open the run of a study, a new one or the one it has, and return its id."""
    runs.experiment(spec.label)  # one that was deleted is restored, and its runs with it
    if run_id is not None and runs.is_there(run_id):
        runs.open_again(run_id)
        return run_id
    tags = {"role": spec.study_role, "study": spec.name, **spec.about}
    params = {**spec.about, "n_trials": n_trials, "seed": spec.seed}
    if isinstance(spec, Declaration):
        tags |= {"surrogate": spec.surrogate, "case": spec.case_name, "case_sha256": spec.digests["case"]}
        params |= {JUDGED_BY: spec.judged_by}
        params |= {f"{SEARCHED}{name}": one for name, one in spec.search.items()}
        set_views(runs, spec.label, spec.search, spec.judged_by)
    made = runs.begin(spec.label, f"{spec.size} study", tags)
    runs.log(made, params=params | {"sampler": spec.sampler["name"], "pruner": spec.pruner["name"]})
    return made


def end_left_runs(runs: RunStore, study: optuna.Study, spec: StudyDeclaration) -> None:
    """End the runs that a worker left open: each takes the state that Optuna gives its trial."""
    left = runs.find(spec.label, {"role": spec.role, "study": spec.name}, status="RUNNING")
    trials = study.get_trials(deepcopy=False)  # later than the runs, so that each run has its trial
    for run in left:
        number = int(run.data.tags.get("trial", -1))
        trial = trials[number] if 0 <= number < len(trials) else None
        if trial is None or trial.user_attrs.get("mlflow_run_id") not in (None, run.info.run_id):
            runs.end(run.info.run_id, "KILLED")
        elif trial.state.is_finished():
            end_run(runs, run.info.run_id, trial, spec)


def without_deleted(runs: RunStore, found: "TunedStudy") -> "tuple[TunedStudy, str]":
    """Leave out of a study the best trials whose runs their owner has deleted in MLflow.

    Returns:
        The study as it is then, whose best trial has weights, and a line that says so; "" where none is gone.
    """
    found, fault, way_back = replace(found, gone=frozenset()), "", ""
    while (best := found.best) is not None:
        is_there = runs.is_there(best.run_id)
        # Weights are kept of trials that were among the best when they ended.
        if is_there and runs.has(best.run_id, SURROGATE):
            break
        if not is_there and not fault:
            fault = f"{best.spec.name}: the run of its best surrogate, {best.model}, was deleted in MLflow"
            way_back = f"mlflow runs restore --run-id {best.run_id}"
        found = replace(found, gone=found.gone | {best.run_id})
    if fault:
        instead = "no other trial has weights" if best is None else f"{best.model} takes its place"
        fault += f": {instead}; to have it back: {way_back}"
    return found, fault


def close_study(runs: RunStore, found: "TunedStudy", spec: Declaration, run_id: str) -> None:
    """Write what a study came to on its run, and end the run.

    Args:
        runs: the project's runs.
        found: all studies whose errors compare.
        spec: the study.
        run_id: its run.
    """
    alone = found.of(spec.name)
    best = alone.best_trial
    numbers: dict[str, float] = {f"n_{one}": alone.count(one) for one in ("complete", "pruned", "failed")}
    for one in (trial for trial in alone.trials if trial.carried_from):
        if runs.is_there(one.run_id):
            runs.log(one.run_id, tags={"carried_to": spec.name})
    if found.gain is not None and found.gain_deviation is not None:
        numbers |= {"confirmed/gain": found.gain, "confirmed/gain_deviation": found.gain_deviation}
    if best is not None:
        numbers |= {f"best/{name}": value for name, value in best.metrics.items()}
        numbers |= {f"best/{n}": v for n, v in best.params.items() if isinstance(v, int | float)}
        if alone.gain is not None:
            numbers["best/gain_over_default"] = alone.gain
    runs.log(run_id, metrics=numbers, tags={"best_trial": "" if best is None else best.number})
    _describe(runs, found, spec, run_id)
    runs.end(run_id, "FINISHED")


def promote(runs: RunStore, found: "TunedStudy") -> tuple[int | None, str]:
    """Mark and register the best trial of a size.

    Args:
        runs: the project's runs.
        found: all studies whose errors compare.

    Returns:
        The model's version, None where none is registered; and, where another one was the champion before,
        a line that says why it is no more.
    """
    best = found.best
    if best is None:
        return None, ""
    mark_best(runs, found.spec, best)
    if found.spec.is_baseline:
        return None, ""
    if found.gain is not None:
        runs.log(best.run_id, metrics={GAIN: found.gain})
    before = runs.champion(best.spec.model_name)
    version = register_best(runs, best)
    if before is None or int(before.version) == version:
        return version, ""
    why = f"n_train {found.spec.n_train}: {_shown(best)} is the best surrogate now, version {version}; "
    why += f"version {before.version} was: {_why_not(runs, found, before.run_id or '')}"
    runs.client.set_model_version_tag(best.spec.model_name, str(version), PROMOTED, why)
    return version, why


def _why_not(runs: RunStore, found: "TunedStudy", run_id: str) -> str:
    """Say why the surrogate of a run is not the best one any more."""
    before = next((one for one in found.trials if one.run_id == run_id), None)
    if before is None:
        data = runs.client.get_run(run_id).data if runs.is_there(run_id) else None
        if data is not None and data.tags.get("study") in {one.spec.name for one in found.trials}:
            unit = difference_unit(found.spec.output_unit)
            return f"a mean of other surrogates (MAE {quantity(data.metrics['val/mae'], unit)})"
        return "it is of other data, or it was deleted"
    return f"{_shown(before)}" + (", deleted in MLflow" if before.run_id in found.gone else "")


def _shown(trial: "TrialView") -> str:
    unit = difference_unit(trial.spec.output_unit)
    return f"{trial.model} of {trial.spec.name} (MAE {quantity(trial.value or 0.0, unit)} on validation rows)"


def log_mean(
    runs: RunStore,
    spec: Declaration,
    *,
    parent: str,
    leading: str,
    params: dict[str, Any],
    metrics: dict[str, float],
    record: dict[str, Any],
    weights: Path,
) -> str:
    """Write a mean of surrogates as a run of its own, and return its id.

    Args:
        runs: the project's runs.
        spec: the study.
        parent: the study's run.
        leading: the run of the network with the largest share, whose curve it shows: a mean has no epochs.
        params: what it is made of.
        metrics: its errors and shares.
        record: what makes it again.
        weights: folder of the saved surrogate.
    """
    role = {"role": "mean", "study": spec.name, PARENT: parent}
    # A killed command left it.
    for left in runs.find(spec.label, role, status="RUNNING"):
        runs.end(left.info.run_id, "KILLED")
    run_id = runs.begin(spec.label, f"{spec.size} mean", {**role, "n_train": spec.n_train})
    runs.log(run_id, params={"n_train": spec.n_train, **params}, metrics=metrics)
    curve = runs.client.get_metric_history(leading, f"{CURVE}{VALIDATION_MAE}")
    name = f"leading/{VALIDATION_MAE}"
    points = [entities.Metric(name, one.value, one.timestamp, one.step) for one in curve]
    runs.client.log_batch(run_id, metrics=points)
    runs.log_record(run_id, record)
    runs.log_files(run_id, sorted(weights.iterdir()), SURROGATE)
    runs.end(run_id, "FINISHED")
    return run_id


def _describe(runs: RunStore, every: "TunedStudy", spec: Declaration, run_id: str) -> None:
    """Say what a study came to at the head of its run's page, and draw its trials."""
    found = every.of(spec.name)
    best = found.best_trial
    said = [f"{count(found.n_ended, 'trial')}, of which {count(found.count('pruned'))} pruned"]
    if n_carried := sum(bool(one.carried_from) for one in found.trials):
        said.append(f"{count(n_carried)} carried over from before the search space was edited")
    if best is not None:
        unit = difference_unit(spec.output_unit)
        said = [
            f" {best.number}: {spec.judged_by} MAE "
            f"{quantity(best.metrics.get(f'{spec.judged_by}/mae', math.nan), unit)}",
            f"P90 {quantity(best.metrics.get(f'{spec.judged_by}/p90', math.nan), unit)}",
            *(f"{name} {setting(value)}" for name, value in best.params.items()),
            *([] if found.gain is None else [f"gain over the default {percent(found.gain)}"]),
            *said,
        ]
    before = runs.client.get_run(run_id).data.tags.get(NOTE, "")
    line = "" if best is None else ", ".join(said)
    runs.log(run_id, tags={NOTE: with_line(before, _BEST_TRIAL, line, spec.note)})
    if every.is_closed or (figure := study_figure(found)) is None:
        return
    with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
        try:
            picture = write_picture(figure, Path(scratch) / "trials.svg", footnote=spec.label)
        except MachineError as error:
            _LOG.warning("%s: %s; its numbers are complete", spec.name, error)
            return
        runs.log_files(run_id, [picture], "figures")


def mark_best(runs: RunStore, spec: Declaration, best: "TrialView") -> None:
    """Give the tag `best` to the best trial's run of a size, and take it from the one that had it."""
    kind = "pca-gp" if spec.is_baseline else "yes"
    for run in runs.find(spec.label, {BEST: kind, "n_train": str(spec.n_train)}):
        if run.info.run_id != best.run_id:
            runs.client.delete_tag(run.info.run_id, BEST)
    runs.log(best.run_id, tags={BEST: kind})
