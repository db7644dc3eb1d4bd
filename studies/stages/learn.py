"""The stage that learns: one tuned surrogate per training-set size."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pelsvae.config import VARIANTS
from simulation.errors import InputError
from studies.console import Column
from studies.recipe import Recipe, recipe_of
from studies.report.wording import count, difference_unit, significant
from studies.stages.pipeline import Outcome, StageError, Study, Summary, run_stage
from studies.stages.simulate import datasets_of, set_files
from studies.stages.tracking import tracker_of
from studies.stages.tuning_progress import TuningProgress
from studies.storage_url import hide_passwords

if TYPE_CHECKING:
    from studies.tuning.study_spec import StudySpec


def tune_stage(study: Study, simulated: Outcome) -> Outcome:
    """Tune one surrogate per training-set size."""
    budget, sizes = study.profile.tuning, study.profile.data.n_train
    n_trials = budget.n_different_trials
    unit = difference_unit(study.case.outputs[0].unit)
    inputs = {
        "simulate": simulated.digest,
        # Rows that were asked again after a failure are other data.
        "data": simulated.summary["digests"],
        "is_log": study.case.parameter_space.is_log.tolist(),
        "output_scales": study.case.measurement.error_scales.tolist(),
        "sizes": list(sizes),
        "tuning": asdict(budget),
        "variant": VARIANTS[budget.variant].to_dict(),
        "seed": study.profile.seed,
    }
    if study.paths.storage is not None:  # finished in the project's own files is not finished on a server
        inputs["storage"] = hide_passwords(study.paths.storage)

    def work() -> tuple[Summary, list[Path]]:
        from studies.tuning.crew import TuningError
        from studies.tuning.tune import tune

        _require_device(study)
        specs = study_specs(study, simulated.summary)
        _say_what_stays_unfinished(study, specs, n_trials)
        tracker = tracker_of(study.paths)
        if n_trials < budget.n_trials:
            study.console.say(
                f"tune: the search space holds {count(n_trials, 'configuration')} and none is trained twice; "
                "widen [tuning.search] for more trials"
            )
        with study.console.bars() as bars, _stage_error(TuningError):
            show = TuningProgress(bars, sizes, n_trials, unit)
            summaries = tune(
                specs,
                paths=study.paths,
                n_trials=n_trials,
                n_jobs=study.n_jobs,
                max_s=None if study.max_hours is None else 3600.0 * study.max_hours,
                tracker=tracker,
                on_event=show.hear,
            )
        n_done = sum(summary.n_trials for summary in summaries)
        without = [summary.n_train for summary in summaries if summary.champion is None]
        if n_done < n_trials * len(sizes) and study.max_hours is not None:
            ended = f"tune: --max-hours ended it after {n_done} of {n_trials * len(sizes)} trials"
            if without:
                none = f"none of n_train = {', '.join(map(str, without))} is complete"
                raise StageError(f"{ended}, {none}; type it again to go on")
            study.console.say(f"{ended}; type it again to go on")
        if without:
            raise InputError(
                f"no trial of n_train = {without[0]} was completed; see mlruns/trials/{study.label}, "
                "give more --trials or epochs"
            )
        champions = [study.paths.champion(study.label, n_train) for n_train in sizes]
        made = [file for folder in champions for file in sorted(folder.iterdir()) if file.is_file()]
        return {"studies": [_study_summary(study, found.to_dict()) for found in summaries]}, made

    return run_stage(
        study,
        "tune",
        what=f"{count(n_trials, 'trial')} for each n_train of {', '.join(map(str, sizes))}",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{count(sum(s['n_trials'] for s in summary['studies']), 'trial')} reused",
        keep=lambda summary: all(
            s["n_trials"] >= n_trials and _has_its_trials(study, s) for s in summary["studies"]
        ),
    )


def _say_what_stays_unfinished(study: Study, specs: "list[StudySpec]", n_trials: int) -> None:
    """Name begun studies of the same sizes that these settings do not go on with."""
    from studies.tuning.trial_store import list_studies, open_trials

    asked = {spec.n_train: spec for spec in specs}
    for entry in list_studies(study.paths):
        spec = asked.get(entry.n_train) if entry.label == study.label else None
        if spec is None or spec.name == entry.name or open_trials(study.paths, spec).finished():
            continue
        n_done = len(open_trials(study.paths, entry.name).finished())
        if n_done < entry.n_planned:
            how = (
                f"--parallel {entry.n_parallel} goes on with it"
                if entry.n_parallel != spec.n_parallel
                else "it has other settings or data"
            )
            study.console.say(f"tune: {entry.name} stays at {n_done} of {entry.n_planned} trials: {how}")


def _has_its_trials(study: Study, found: Summary) -> bool:
    """Tell whether no trial of a finished study was lost; one whose records stayed elsewhere lost none."""
    from studies.tuning.trial_store import open_trials

    left = open_trials(study.paths, found["study"]).finished()
    return not left or len(left) >= found["n_trials"]


def study_specs(study: Study, simulated: Summary) -> "list[StudySpec]":
    """Return one Optuna study per training-set size.

    Args:
        study: the study.
        simulated: summary of the finished simulate stage.
    """
    from studies.tuning.study_spec import StudySpec

    budget, files = study.profile.tuning, set_files(study, simulated)
    # One thread in training and prediction: the same numbers whatever --jobs says.
    overrides = {name: getattr(budget, name) for name in ("max_epochs", "patience", "device")}
    overrides["n_threads"] = 1
    specs = [
        StudySpec.from_files(
            train_file=files["train"],
            validation_file=files["validation"],
            test_file=files["test"],
            n_train=n_train,
            parameter_space=study.case.parameter_space,
            label=study.label,
            case_name=study.case.name,
            case_digest=study.case.digest,
            fmu_sha256=study.case.fmu_sha256,
            output_unit=study.case.outputs[0].unit,
            output_scales=tuple(study.case.measurement.error_scales.tolist()),
            variant=budget.variant,
            overrides=overrides,
            search=budget.ranges,
            pruner=budget.pruner,
            objectives=budget.objectives,
            enqueue=budget.enqueue,
            warm_start=budget.warm_start,
            n_parallel=budget.n_parallel,
            max_trial_s=budget.max_trial_s,
            seed=study.profile.seed,
            note=study.case.note,
        )
        for n_train in study.profile.data.n_train
    ]
    return [replace(spec, recipe=_recipe(study, spec, simulated)) for spec in specs]


def _recipe(study: Study, spec: "StudySpec", simulated: Summary) -> Recipe:
    """Return what rebuilds the trainings of one size."""
    return recipe_of(
        study,
        "training",
        command=f"studies tune {study.words('data', 'tuning')}",
        n_train=spec.n_train,
        datasets=datasets_of(study.profile, spec.n_train, spec.digests, simulated["files"]),
    )


def show_tuning(study: Study, outcome: Outcome) -> None:
    """Print the best surrogate of each size."""
    from studies.tuning.study_spec import output_metric

    unit = difference_unit(study.case.outputs[0].unit)
    columns = [
        Column("n_train", True),
        Column("trials", True),
        Column("pruned", True),
        Column("failed", True),
    ]
    behind = f" [{unit}]" if unit else ""
    columns += [Column(f"{name}{behind}", True) for name in ("MAE val", "MAE test", "P90 test")]
    several = study.case.outputs if len(study.case.outputs) > 1 else ()
    columns += [Column(f"{one.name} [{difference_unit(one.unit)}]", True) for one in several]
    searched = study.profile.tuning.ranges.names
    columns += [Column(name, True) for name in searched]
    rows = []
    for found in outcome.summary["studies"]:
        errors, config = found["best_metrics"], found["best_config"]
        cells = [found["n_train"], found["n_trials"], found["n_pruned"], found["n_failed"]]
        cells += [significant(errors[name]) for name in ("val/mae", "test/mae", "test/p90")]
        cells += [significant(errors[f"test/{output_metric(one.name)}"]) for one in several]
        rows.append([*cells, *(f"{config[name]:.3g}" for name in searched)])
    study.console.table(f"{study.label}: best surrogate per training-set size", columns, rows)
    if len(study.profile.tuning.objectives) > 1:
        _show_front(study, outcome, behind)


def _show_front(study: Study, outcome: Outcome, behind: str) -> None:
    """Print the trials that no other one beats in all errors that were minimized."""
    from studies.tuning.front import pareto_front
    from studies.tuning.trial_store import open_trials

    columns = [Column("n_train", True), Column("trial", True)]
    columns += [Column(f"{name}{behind}", True) for name in ("MAE val", "P90 val", "MAE test", "P90 test")]
    searched = study.profile.tuning.ranges.names
    columns += [Column(name, True) for name in searched]
    rows = []
    for found in outcome.summary["studies"]:
        records = open_trials(study.paths, found["study"]).records()
        for record in pareto_front(records, study.profile.tuning.objectives):
            errors = ("val/mae", "val/p90", "test/mae", "test/p90")
            cells = [significant(record.metrics[name]) for name in errors]
            cells += [f"{record.config[name]:.3g}" for name in searched]
            rows.append([found["n_train"], record.index, *cells])
    study.console.table(f"{study.label}: trials that no other one beats in both errors", columns, rows)


def _require_device(study: Study) -> None:
    """Refuse a device that is not there before a worker is started for it."""
    if study.profile.tuning.device == "cuda":
        from pelsvae.device import resolve_device

        try:
            resolve_device("cuda")
        except ValueError as error:
            raise InputError(f"profile {study.profile.name}: tuning.device: {error}") from None


@contextmanager
def _stage_error(kind: type[Exception]) -> Iterator[None]:
    try:
        yield
    except kind as error:
        raise StageError(f"tune: {error}") from error


def _study_summary(study: Study, summary: dict[str, Any]) -> dict[str, Any]:
    """Return a summary whose champion is named relative to the project, so that it can be moved."""
    return {**summary, "champion": study.paths.recorded(Path(summary["champion"]))}
