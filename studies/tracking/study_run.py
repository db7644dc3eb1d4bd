"""A study as MLflow shows it: a run above those of its trials, its best surrogate in the registry."""

import logging
import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import optuna

from simulation.errors import MachineError
from studies.reporting.drawing import write_picture
from studies.reporting.figures_tuning import study_figure
from studies.results.declaration import Declaration
from studies.tracking.leaderboard import GAIN, SEARCHED, set_views
from studies.tracking.runs import SURROGATE, RunStore, register_best
from studies.tracking.study_tags import NOTE, with_line
from studies.tracking.trial_run import end_run, trial_role
from studies.words.wording import count, difference_unit, percent, quantity, setting

if TYPE_CHECKING:
    from studies.results.trials import TrialView, TunedStudy

_LOG = logging.getLogger(__name__)
_BEST_TRIAL = "Best trial"
BEST = "best"
"""Tag of the run of the best trial of a training-set size: `tags.best = 'yes'` is the leaderboard."""


def open_study_run(runs: RunStore, spec: Declaration, n_trials: int, run_id: str | None) -> str:
    """Open the run of a study, a new one or the one it has, and return its id."""
    runs.experiment(spec.label)  # one that was deleted is restored, and its runs with it
    if run_id is not None and runs.is_there(run_id):
        runs.open_again(run_id)
        return run_id
    role = "baseline study" if spec.is_baseline else "study"
    tags = {"role": role, "study": spec.name, "n_train": spec.n_train, "surrogate": spec.surrogate}
    tags |= {"case": spec.case_name, "case_sha256": spec.digests["case"]}
    set_views(runs, spec.label, spec.search)
    made = runs.begin(spec.label, f"{spec.size} study", tags)
    params = {"n_train": spec.n_train, "n_trials": n_trials, "seed": spec.seed}
    params |= {"sampler": spec.sampler["name"], "pruner": spec.pruner["name"]}
    runs.log(made, params=params | {f"{SEARCHED}{name}": one for name, one in spec.search.items()})
    return made


def end_left_runs(runs: RunStore, study: optuna.Study, spec: Declaration) -> None:
    """End the runs that a worker left open: each takes the state that Optuna gives its trial."""
    left = runs.find(spec.label, {"role": trial_role(spec), "study": spec.name}, status="RUNNING")
    trials = study.get_trials(deepcopy=False)  # later than the runs, so that each run has its trial
    for run in left:
        number = int(run.data.tags.get("trial", -1))
        trial = trials[number] if 0 <= number < len(trials) else None
        if trial is None or trial.user_attrs.get("mlflow_run_id") not in (None, run.info.run_id):
            runs.end(run.info.run_id, "KILLED")
        elif trial.state.is_finished():
            end_run(runs, run.info.run_id, trial)


def without_deleted(runs: RunStore, found: "TunedStudy") -> "tuple[TunedStudy, str]":
    """Leave out of a study the best trials whose runs their owner has deleted in MLflow.

    Returns:
        The study as it is then, whose best trial has weights, and a line that says so; "" where none is gone.
    """
    found, fault, way_back = replace(found, gone=frozenset()), "", ""
    while (best := found.best) is not None:
        is_there = runs.is_there(best.run_id)
        # Of trials that were not the best when they ended no weights were kept.
        if is_there and (not fault or runs.has(best.run_id, SURROGATE)):
            break
        if not is_there and not fault:
            fault = f"{found.spec.name}: the run of its best trial, {best.number}, was deleted in MLflow"
            way_back = f"mlflow runs restore --run-id {best.run_id}"
        found = replace(found, gone=found.gone | {best.run_id})
    if fault:
        instead = "no other trial has weights" if best is None else f"trial {best.number} takes its place"
        fault += f": {instead}; to have it back: {way_back}"
    return found, fault


def close_study(runs: RunStore, spec: Declaration, found: "TunedStudy", run_id: str) -> None:
    """Write what a study came to on its run, mark and register its best trial, and end the run."""
    best = found.best
    numbers: dict[str, float] = {f"n_{one}": found.count(one) for one in ("complete", "pruned", "failed")}
    if best is not None:
        numbers |= {f"best/{name}": value for name, value in best.metrics.items()}
        numbers |= {f"best/{n}": v for n, v in best.params.items() if isinstance(v, int | float)}
        if found.gain is not None:
            numbers["best/gain_over_default"] = found.gain
            runs.log(best.run_id, metrics={GAIN: found.gain})
        mark_best(runs, spec, best)
        if not spec.is_baseline:
            register_best(runs, spec, best)
    runs.log(run_id, metrics=numbers, tags={"best_trial": "" if best is None else best.number})
    _describe(runs, found, run_id)
    runs.end(run_id, "FINISHED")


def _describe(runs: RunStore, found: "TunedStudy", run_id: str) -> None:
    """Say what a study came to at the head of its run's page, and draw its trials."""
    spec, best = found.spec, found.best
    said = [f"{count(found.n_ended, 'trial')}, of which {count(found.count('pruned'))} pruned"]
    if best is not None:
        unit = difference_unit(spec.output_unit)
        said = [
            f" {best.number}: test MAE {quantity(best.metrics.get('test/mae', math.nan), unit)}",
            f"P90 {quantity(best.metrics.get('test/p90', math.nan), unit)}",
            *(f"{name} {setting(value)}" for name, value in best.params.items()),
            *([] if found.gain is None else [f"gain over the default {percent(found.gain)}"]),
            *said,
        ]
    before = runs.client.get_run(run_id).data.tags.get(NOTE, "")
    line = "" if best is None else ", ".join(said)
    runs.log(run_id, tags={NOTE: with_line(before, _BEST_TRIAL, line, spec.note)})
    if found.n_closed == len(found.trials) or (figure := study_figure(found)) is None:
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
