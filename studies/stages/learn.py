"""The stage that learns: one Optuna study per training-set size, and PCA + GP beside it."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from optuna.trial import FrozenTrial

from pelsvae.config import VARIANTS
from pelsvae.device import resolve_device
from simulation.errors import InputError
from studies.calibration.hidden_network.inputs import drive_of
from studies.own_surrogate import own_defaults
from studies.reporting.sentences import mean_sentences
from studies.reporting.tables import tuning_table
from studies.results.declaration import DRIVE, Declaration, digest_of_arrays
from studies.results.outcome import Outcome, digest_of
from studies.results.row_set import RowSet
from studies.results.saved import write_arrays
from studies.results.stage_results import SimulatedSets, Tuned
from studies.results.trials import TunedStudy
from studies.search_space import FORMS, NETWORK_SPACE, SearchParameter, form_of, is_own
from studies.stages.simulate_stage import set_files
from studies.task import StageError, Task
from studies.tracking.sending import begin_sending
from studies.tuning.attempts import places
from studies.tuning.sampler import make_pruner, make_sampler
from studies.tuning.study_results import of_project
from studies.tuning.tune_studies import closed_studies, tune
from studies.words.wording import count, difference_unit, quantity


def require_tuning(task: Task) -> None:
    """Refuse a sampler, pruner or device that does not exist, before a simulation is spent.

    Raises:
        InputError: there is no such sampler, pruner or device.
    """
    make_sampler(task.profile.tuning.sampler, task.profile.seed)
    make_pruner(task.profile.tuning.pruner)
    if is_own(surrogate := task.profile.tuning.surrogate):
        own_defaults(surrogate, {**task.profile.tuning.space, **task.profile.tuning.fixed})
    if task.profile.tuning.device == "cuda":
        try:
            resolve_device("cuda")
        except ValueError as error:
            raise InputError(f"profile {task.profile.name}: tuning.device: {error}") from None


def written_drive(task: Task) -> tuple[str, str] | None:
    """Write what drives the case's model for workers; return the file, as declarations name it, and a digest.

    None where decoders cannot know it: experiments with different inputs, outputs or communication steps.
    """
    drive = drive_of(task.case)
    if drive is None:
        return None
    arrays = drive.to_arrays()
    digest = digest_of_arrays(arrays)
    file = task.paths.generated(task.case.name) / "drives" / f"drive-{digest[:12]}.npz"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        write_arrays(file, arrays)
    return task.paths.recorded(file), digest


def tune_stage(task: Task, simulated: Outcome[SimulatedSets]) -> Outcome[Tuned]:
    """Bring the study of each training-set size to its trials; Optuna knows what is finished."""
    budget, sizes = task.profile.tuning, task.profile.data.n_train
    started_s = time.perf_counter()
    specs = declarations(task, simulated.result)
    found = closed_studies(specs, task.paths, budget.n_trials, budget.confirm)
    if found is not None:
        begin_sending(task.paths)  # what an earlier command could not send
        n = sum(one.n_ended for one in found)
        task.console.say(f"tune: finished before, {count(n, 'trial')} reused")
        return _outcome(specs, found, reused=True, wall_s=sum(one.wall_s for one in found))
    what = f"{count(budget.n_trials, 'trial')} for each n_train of {', '.join(map(str, sizes))}"
    with task.console.stage("tune", what), task.console.bars() as bars:
        unit = difference_unit(task.case.outputs[0].unit)

        def show(spec: Declaration, trials: Sequence[FrozenTrial]) -> None:
            done, total, best = _progress(spec, trials, budget.n_trials)
            news = "" if best is None else f": best MAE {quantity(best, unit)}"
            bars(f"n_train {spec.size.removeprefix('n').lstrip('0')}", done, total, news)

        found = tune(
            specs,
            paths=task.paths,
            n_trials=budget.n_trials,
            n_jobs=task.n_jobs,
            n_parallel=budget.n_parallel,
            until_s=task.until_s,
            provenance=task.provenance(kind="training"),
            on_trials=show,
            on_warning=task.console.warn,
            on_news=task.console.say,
            confirm=budget.confirm,
        )
    tuned = [one for one in found if not one.spec.is_baseline]
    without = [one.spec.n_train for one in tuned if one.best is None]
    n_done = sum(
        one.of(spec.name).n_ended for one, spec in zip(found, specs, strict=True) if not spec.is_baseline
    )
    n_all = budget.n_trials * len(sizes)
    if task.max_hours is not None and n_done < n_all:
        ended = f"tune: --max-hours ended it after {n_done} of {n_all} trials; the same command goes on"
        if without:
            raise StageError(f"{ended}; n_train = {', '.join(map(str, without))} has no complete trial yet")
        task.console.say(ended)
    if without and any(one.gone for one in tuned if one.best is None):
        raise InputError(
            f"no trial of n_train = {without[0]} can be used: their runs were deleted in MLflow; restore "
            "one (mlflow runs restore), or give more --trials"
        )
    if without:
        raise InputError(
            f"no trial of n_train = {without[0]} was completed; `studies status` counts them, "
            "MLflow has their reasons; give more --trials or epochs"
        )
    return _outcome(specs, found, reused=False, wall_s=time.perf_counter() - started_s)


def declarations(task: Task, simulated: SimulatedSets) -> list[Declaration]:
    """Return the study of each training-set size, and the baseline of each beside it.

    Args:
        task: the task.
        simulated: the sets.
    """
    budget, space = task.profile.tuning, task.case.parameter_space
    sets = {name: RowSet.load(file).read() for name, file in set_files(task, simulated).items()}
    given = {"max_epochs": budget.max_epochs, "patience": budget.patience}
    longer = {name: value for name, value in given.items() if value is not None} | dict(budget.fixed)
    surrogate = form_of(budget.surrogate, budget.fixed)
    search, files, driven = dict(budget.space), dict(simulated.files), dict[str, str]()
    decoders: Sequence[Any] = ()
    if not is_own(surrogate):
        decoders = search["decoder"].choices if "decoder" in search else (VARIANTS[surrogate].decoder,)
    if "state-space" in decoders:
        if (written := written_drive(task)) is not None:
            files[DRIVE], driven[DRIVE] = written
        elif "decoder" in budget.fixed:
            raise InputError(
                f"profile {task.profile.name}: tuning.fixed.decoder: the experiments differ in inputs, "
                'outputs or step; fix "layers"'
            )
        else:
            task.console.warn("tune: the experiments differ in inputs, outputs or step: layers decode alone")
            search = {name: one for name, one in search.items() if name in NETWORK_SPACE}
            surrogate, decoders = "refined", ("layers",)
    forms = {str(one): _settings(FORMS[str(one)], longer) for one in decoders} if "decoder" in search else {}
    found = []
    for n_train in task.profile.data.n_train:
        digests = {name: one.digest for name, one in sets.items()}
        digests["train"] = sets["train"].take(np.arange(n_train)).digest
        spec = Declaration(
            label=task.label,
            n_train=n_train,
            case_name=task.case.name,
            surrogate=surrogate,
            settings=own_settings(surrogate, search, budget.fixed) or _settings(surrogate, longer),
            forms=forms,
            search={name: one.to_dict() for name, one in search.items()},
            sampler=budget.sampler,
            pruner=budget.pruner,
            enqueue=tuple(dict(point) for point in budget.enqueue),
            seed=task.profile.seed,
            parameter_names=space.names,
            lower=tuple(space.lower.tolist()),
            upper=tuple(space.upper.tolist()),
            is_log=tuple(space.is_log.tolist()),
            output_names=tuple(sets["train"].output_names),
            output_unit=task.case.outputs[0].unit,
            output_scales=tuple(task.case.measurement.error_scales.tolist()),
            files=files,
            digests={"case": task.case.digest, "fmu": task.case.fmu.sha256, **digests, **driven},
            device=budget.device,
            max_trial_s=budget.max_trial_s,
            note=task.case.note,
            folds=task.profile.data.folds or 0,
        )
        found.append(spec)
        if budget.baseline and budget.surrogate != "pca-gp":
            baseline = replace(
                spec,
                surrogate="pca-gp",
                settings=_settings("pca-gp", {}),
                forms={},
                search={},
                files=simulated.files,
                digests={name: one for name, one in spec.digests.items() if name != DRIVE},
                sampler={"name": "RandomSampler"},
                pruner={"name": "NopPruner"},
                enqueue=(),
                is_baseline=True,
            )
            found.append(baseline)
    return of_project(found, task.paths)


def own_settings(
    surrogate: str, search: Mapping[str, SearchParameter], fixed: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the keywords that all trials of a user's class share, with a value of those searched.

    Empty where the surrogate is none of a user's.
    """
    if not is_own(surrogate):
        return {}
    first = {name: one.choices[0] if one.choices else one.low for name, one in search.items()}
    return {**first, **own_defaults(surrogate, {**search, **fixed}), **fixed}


def _settings(surrogate: str, changes: dict[str, Any]) -> dict[str, Any]:
    config = VARIANTS[surrogate].replace(**changes)
    # What layers and processes do not have is left out: studies of before keep their names.
    of_states = ("decoder", "states", "n_stores", "sparsity") if config.decoder == "layers" else ()
    left_out = ("device", "n_threads", *of_states)
    return {name: value for name, value in config.to_dict().items() if name not in left_out}


def _progress(
    spec: Declaration, trials: Sequence[FrozenTrial], n_trials: int
) -> tuple[int, int, float | None]:
    """Return what is done of a task, what there is to do, and its best error so far."""
    latest = places(trials)
    planned = 1 if spec.is_baseline else 0 if spec.is_confirmation else n_trials
    total = max(planned, len(latest))
    done = sum(trial.state.is_finished() for trial in latest)
    values = [t.value for t in latest if t.state.name == "COMPLETE" and t.value is not None]
    return done, total, min(values, default=None)


def _outcome(
    specs: Sequence[Declaration], found: Sequence[TunedStudy], *, reused: bool, wall_s: float
) -> Outcome[Tuned]:
    digest = digest_of({"studies": [spec.name for spec in specs], "ended": [one.n_ended for one in found]})
    tuned = Tuned(tuple(one.summary(found) for one in found if not one.spec.is_baseline))
    return Outcome("tune", tuned, digest, reused=reused, wall_s=wall_s)


def show_tuning(task: Task, found: Tuned) -> None:
    """Print the best surrogate of each size."""
    if (table := tuning_table(found.studies)) is not None:
        task.console.show([table, *mean_sentences(found.studies)])
