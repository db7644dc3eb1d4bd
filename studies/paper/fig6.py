"""Fig. 6: every trial's error over the training-set size, the best of each starred, PCA + GP as a line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from studies.paper.items import Cell, Origin, Shown, origin_of, write_size
from studies.paper.plan import Plan
from studies.paper.published import FIG_6_MAE, FIG_6_RANGE
from studies.reporting.figures_model import TrialsRecord, mae_over_n_figure
from studies.results.outcome import Outcome
from studies.results.row_set import RowSet
from studies.results.stage_results import SimulatedSets
from studies.results.trials import TrialView, TunedStudy
from studies.search_space import SearchParameter
from studies.stages.learn import tune_stage
from studies.stages.simulate_stage import set_files, simulate_stage
from studies.stages.tuned_trials import tuned_by_size
from studies.task import Task
from studies.tuning.study_results import importances

SETTINGS = ("n_latent", "n_hidden", "beta", "learning_rate")


@dataclass(frozen=True)
class Trial:
    """One trial that has ended.

    Args:
        number: Optuna's number of the trial.
        state: "complete", "pruned" or "failed".
        proposed_by: "default", "profile", "start-up" or the sampler's name.
        params: its hyperparameters.
        val_mae: validation MAE; of a pruned trial the last one reported. [output's unit]
        val_p90: 90th percentile on the validation set, of a complete trial. [output's unit]
        test_mae: test MAE of a complete trial. [output's unit]
        test_p90: 90th percentile on the test set, of a complete trial. [output's unit]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept; 0 unless complete.
        wall_s: duration of the training. [s]
    """

    number: int
    state: str
    proposed_by: str
    params: dict[str, float | int | str | bool]
    val_mae: float | None
    val_p90: float | None
    test_mae: float | None
    test_p90: float | None
    n_epochs: int
    best_epoch: int
    wall_s: float


@dataclass(frozen=True)
class Tuning:
    """An Optuna study: one form of the surrogate, one training-set size.

    Args:
        surrogate: the form, for example "refined".
        study: name of the Optuna study; its end is the digest of all that decides the trials.
        n_planned: trials it shall have.
        settings: settings that its trials share, where a trial has no other.
        search: search space, as JSON values by hyperparameter.
        sampler: Optuna's sampler: its name and arguments.
        pruner: the pruner: its name and arguments.
        trials: its trials that have ended.
    """

    surrogate: str
    study: str
    n_planned: int
    settings: dict[str, Any]
    search: dict[str, dict[str, Any]]
    sampler: dict[str, Any]
    pruner: dict[str, Any]
    trials: tuple[Trial, ...]

    @cached_property
    def best(self) -> Trial:
        """The complete trial of least validation error."""
        complete = [trial for trial in self.trials if trial.state == "complete"]
        return min(complete, key=lambda trial: (_known(trial.val_mae), trial.number))


@dataclass(frozen=True)
class SizeTrials:
    """All trials of one training-set size.

    Args:
        n_train: training-set size.
        mean_predictor_mae: test error of predicting the training set's mean trajectory. [output's unit]
        networks: the surrogate of the profile.
        faithful: the form of the paper beside it, None without.
        pca_gp: PCA + GP, fitted once, None without.
    """

    n_train: int
    mean_predictor_mae: float
    networks: Tuning
    faithful: Tuning | None
    pca_gp: Tuning | None


SIZE = SizeTrials


def run(plan: Plan) -> Shown:
    """Tune every size on the window of Fig. 6, the faithful form beside it, and show all trials."""
    task, beside = plan.hyperparameter_study(), plan.faithful_study()
    simulated = tune_sizes(task, plan.budget.trials)
    if beside is not None:
        tune_sizes(beside, plan.budget.faithful_trials)
    networks, pca_gp = _tunings(task), _tunings(task, baseline=True)
    faithful = {} if beside is None else _tunings(beside)
    mean_mae = _mean_predictor(task, simulated)
    sizes = [
        SizeTrials(n, mean_mae[n], networks[n], faithful.get(n), pca_gp.get(n)) for n in sorted(networks)
    ]
    origin = origin_of(plan, task, "fig6")
    for size in sizes:
        write_size(plan.folder("fig6"), origin, size.n_train, size)
    return shown(origin, sizes)


def tune_sizes(task: Task, trials: Mapping[int, int]) -> Outcome[SimulatedSets]:
    """Simulate the sets of a study and tune all its sizes.

    Args:
        task: the task, with all sizes.
        trials: trials by size.

    Returns:
        What was simulated.
    """
    simulated = simulate_stage(task)
    # Breadth first: an interruption leaves something of every size.
    for n_trials in sorted(set(trials.values())):
        profile = task.profile
        data = replace(profile.data, n_train=tuple(n for n in trials if trials[n] >= n_trials))
        profile = replace(profile, data=data, tuning=replace(profile.tuning, n_trials=n_trials))
        tune_stage(replace(task, profile=profile), simulated)
    return simulated


def shown(origin: Origin, sizes: Sequence[SizeTrials]) -> Shown:
    """Return Fig. 6.

    Args:
        origin: where the sizes come from.
        sizes: all trials by size, the smallest first.
    """
    window, rows = f"days {origin.window_d[0]:g} to {origin.window_d[1]:g}", [_row(size) for size in sizes]
    published = {n: (mae,) for n, mae in FIG_6_MAE.items()} | {FIG_6_RANGE[0]: FIG_6_RANGE[1:]}
    return Shown(
        f"Fig. 6: hyperparameters tuned on {window}; test errors [{origin.unit}] of the best by validation",
        tuple(rows[0]),
        tuple(tuple(row.values()) for row in rows),
        "mae-over-n.png",
        mae_over_n_figure(_record(sizes), unit=origin.unit, published=published, beside=_beside(sizes)),
        f"{origin.label}, {window}",
        {"importances": importances_by_size(sizes)},
    )


def _row(size: SizeTrials) -> dict[str, Cell]:
    tuning, best = size.networks, size.networks.best
    settings: dict[str, Any] = {**tuning.settings, **best.params}
    default = next((t for t in tuning.trials if t.proposed_by == "default" and t.state == "complete"), None)
    beside = None if size.pca_gp is None else size.pca_gp.best
    return {
        "n_train": size.n_train,
        "trials": len(tuning.trials),
        "pruned": sum(trial.state == "pruned" for trial in tuning.trials),
        "MAE": best.test_mae,
        "P90": best.test_p90,
        **{name: settings[name] for name in SETTINGS},
        "MAE untuned": None if default is None else default.test_mae,
        "gain": None if default is None else 1.0 - _known(best.test_mae) / _known(default.test_mae),
        "PCA+GP MAE": None if beside is None else beside.test_mae,
        "PCA+GP P90": None if beside is None else beside.test_p90,
        "faithful MAE": None if size.faithful is None else size.faithful.best.test_mae,
        "mean's MAE": size.mean_predictor_mae,
        "paper MAE": FIG_6_MAE.get(size.n_train),
    }


def importances_by_size(sizes: Sequence[SizeTrials]) -> dict[str, dict[str, float]]:
    """Return the importance of each hyperparameter by size, and over all sizes together. [1].

    Pruned trials count with their last validation error. Over all sizes the error is that divided by the best
    of the size.
    """
    found: dict[str, dict[str, float]] = {}
    points: list[dict[str, Any]] = []
    ratios: list[float] = []
    space = {name: SearchParameter(**one) for name, one in sizes[0].networks.search.items()}
    for size in sizes:
        judged = [trial for trial in size.networks.trials if trial.val_mae is not None and trial.params]
        here, values = [trial.params for trial in judged], [_known(trial.val_mae) for trial in judged]
        found[str(size.n_train)] = importances(here, values, space)
        points += here
        ratios += [value / _known(size.networks.best.val_mae) for value in values]
    return {**found, "all": importances(points, ratios, space)}


def _record(sizes: Sequence[SizeTrials]) -> TrialsRecord:
    trials = [(size, trial) for size in sizes for trial in size.networks.trials]
    return TrialsRecord.of(
        [
            (
                size.n_train, trial.state, trial.val_mae, trial.test_mae, trial.test_p90,
                trial is size.networks.best,
            )
            for size, trial in trials
        ]
    )  # fmt: skip


def _beside(sizes: Sequence[SizeTrials]) -> dict[str, dict[int, tuple[float, float]]]:
    """Return test MAE and 90th percentile of the other surrogates by name and size. [output's unit]."""
    found = {}
    for name, tunings in (
        ("PCA + GP", {size.n_train: size.pca_gp for size in sizes}),
        ("faithful form, its best", {size.n_train: size.faithful for size in sizes}),
    ):
        best = {n: tuning.best for n, tuning in tunings.items() if tuning is not None}
        if best:
            found[name] = {n: (_known(one.test_mae), _known(one.test_p90)) for n, one in best.items()}
    return found


def _known(error: float | None) -> float:
    return np.inf if error is None else error


def _mean_predictor(task: Task, simulated: Outcome[SimulatedSets]) -> dict[int, float]:
    """Return the test error of predicting the training set's mean trajectory, by size. [output's unit]."""
    files = set_files(task, simulated.result)
    scales = task.case.measurement.error_scales
    train, test = (RowSet.load(files[name]).read().y for name in ("train", "test"))
    test = test[np.isfinite(test).all(axis=(1, 2))]
    return {
        n: float(np.mean(np.abs(np.nanmean(train[:n], axis=0) - test) * scales))
        for n in task.profile.data.n_train
    }


def _tunings(task: Task, *, baseline: bool = False) -> dict[int, Tuning]:
    found = tuned_by_size(task, baseline=baseline)
    return {n: _tuning(one) for n, one in found.items() if one.best is not None}


def _tuning(study: TunedStudy) -> Tuning:
    spec = study.spec
    # A complete trial without a run was added by hand and has no errors on the test set.
    ended = [trial for trial in study.proposals if trial.state in ("complete", "pruned", "failed")]
    ours = [trial for trial in ended if trial.run_id or trial.state != "complete"]
    return Tuning(
        surrogate=spec.surrogate,
        study=spec.name,
        n_planned=study.n_planned,
        settings=spec.settings,
        search=spec.search,
        sampler=spec.sampler,
        pruner=spec.pruner,
        trials=tuple(map(_trial, ours)),
    )


def _trial(trial: TrialView) -> Trial:
    return Trial(
        number=trial.number,
        state=trial.state,
        proposed_by=trial.proposed_by,
        params=dict(trial.params),
        val_mae=trial.value,
        val_p90=trial.metrics.get("val/p90"),
        test_mae=trial.metrics.get("test/mae"),
        test_p90=trial.metrics.get("test/p90"),
        n_epochs=trial.n_epochs,
        best_epoch=trial.best_epoch,
        wall_s=round(trial.wall_s, 1),
    )
