"""A study as MLflow shows it: a run above those of its trials, its best surrogate in the registry."""

from typing import TYPE_CHECKING

import optuna

from studies.results.declaration import Declaration
from studies.tracking.runs import RunStore, register_best
from studies.tracking.trial_run import end_run

if TYPE_CHECKING:
    from studies.results.trials import TrialView, TunedStudy

BEST = "best"
"""Tag of the run of the best trial of a training-set size: `tags.best = 'yes'` is the leaderboard."""


def open_study_run(runs: RunStore, spec: Declaration, n_trials: int, run_id: str | None) -> str:
    """Open the run of a study, a new one or the one it has, and return its id."""
    if run_id is not None and runs.is_there(run_id):
        runs.open_again(run_id)
        return run_id
    role = "baseline study" if spec.is_baseline else "study"
    tags = {"role": role, "study": spec.name, "n_train": spec.n_train, "surrogate": spec.surrogate}
    tags |= {"case": spec.case_name, "case_sha256": spec.digests["case"]}
    made = runs.begin(spec.label, f"{spec.size} study", tags)
    params = {"n_train": spec.n_train, "n_trials": n_trials, "seed": spec.seed}
    params |= {"sampler": spec.sampler["name"], "pruner": spec.pruner["name"]}
    runs.log(made, params=params | {f"search.{name}": one for name, one in spec.search.items()})
    return made


def end_left_runs(runs: RunStore, study: optuna.Study, spec: Declaration) -> None:
    """End the runs that a worker left open: each takes the state that Optuna gives its trial."""
    left = runs.find(spec.label, {"role": "trial", "study": spec.name}, status="RUNNING")
    trials = study.get_trials(deepcopy=False)  # later than the runs, so that each run has its trial
    for run in left:
        number = int(run.data.tags.get("trial", -1))
        trial = trials[number] if 0 <= number < len(trials) else None
        if trial is None or trial.user_attrs.get("mlflow_run_id") not in (None, run.info.run_id):
            runs.end(run.info.run_id, "KILLED")
        elif trial.state.is_finished():
            end_run(runs, run.info.run_id, trial)


def close_study(runs: RunStore, spec: Declaration, found: "TunedStudy", run_id: str) -> str:
    """Write what a study came to on its run, mark and register its best trial, and end the run.

    Returns:
        What is in the way of the mark and the registration, in one line; "" where nothing is.
    """
    best, fault = found.best, ""
    if best is not None and not runs.is_there(best.run_id):
        fault = (
            f"{spec.name}: the run of its best trial, {best.number}, was deleted in MLflow, so it is not "
            f"registered; to have it back: mlflow runs restore --run-id {best.run_id}"
        )
    numbers: dict[str, float] = {f"n_{one}": found.count(one) for one in ("complete", "pruned", "failed")}
    if best is not None:
        numbers |= {f"best/{name}": value for name, value in best.metrics.items()}
        numbers |= {f"best/{n}": v for n, v in best.params.items() if isinstance(v, int | float)}
        if found.gain is not None:
            numbers["best/gain_over_default"] = found.gain
        if not fault:
            mark_best(runs, spec, best)
        if not fault and not spec.is_baseline:
            register_best(runs, spec, best)
    runs.log(run_id, metrics=numbers, tags={"best_trial": "" if best is None else best.number})
    runs.end(run_id, "FINISHED")
    return fault


def mark_best(runs: RunStore, spec: Declaration, best: "TrialView") -> None:
    """Give the tag `best` to the best trial's run of a size, and take it from the one that had it."""
    kind = "pca-gp" if spec.is_baseline else "yes"
    for run in runs.find(spec.label, {BEST: kind, "n_train": str(spec.n_train)}):
        if run.info.run_id != best.run_id:
            runs.client.delete_tag(run.info.run_id, BEST)
    runs.log(best.run_id, tags={BEST: kind})
