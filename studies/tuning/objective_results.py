"""What the studies of a user's objective have come to, read from Optuna alone."""

from collections.abc import Sequence

import optuna
from optuna.trial import FrozenTrial, TrialState

from studies.paths import ProjectPaths
from studies.results.objective import ObjectiveDeclaration, ObjectiveTrial, TunedObjective
from studies.tuning import attempts
from studies.tuning.storage import storage_of
from studies.tuning.stored_trials import stored_trials
from studies.tuning.study_results import readable


def read_objectives(paths: ProjectPaths) -> list[TunedObjective]:
    """Read the studies of objectives of a project, the earliest first.

    Raises:
        InputError: the database is no longer as this program and Optuna have written it.
    """
    if paths.storage is None and not paths.optuna_database.is_file():
        return []
    found = []
    with storage_of(paths) as storage, readable(paths):
        for known in storage.get_all_studies():
            declared = known.user_attrs.get(attempts.DECLARATION)
            is_ours = isinstance(declared, dict) and attempts.is_of_objective(declared)
            if is_ours and declared.get("project", "") in ("", paths.identity):
                study = optuna.load_study(study_name=known.study_name, storage=storage)
                found.append(read_objective(study, stored_trials(storage, known._study_id)))
    return sorted(found, key=lambda one: one.number)


def read_objective(study: optuna.Study, trials: Sequence[FrozenTrial]) -> TunedObjective:
    """Return what a study of these trials has come to."""
    spec = attempts.declaration_of(study)
    assert isinstance(spec, ObjectiveDeclaration), "of a user's study"
    places = {trial.number: _view(spec, trial) for trial in attempts.places(trials)}
    # A constraint of a trial counts before its values; Optuna knows how.
    best = [places[one.number] for one in study.best_trials if one.number in places]
    sign = -1.0 if spec.directions[0] == "maximize" else 1.0
    best.sort(key=lambda one: sign * next(iter(one.values.values())))
    attrs = study.user_attrs
    return TunedObjective(
        spec=spec,
        number=study._study_id,
        n_planned=int(attrs.get(attempts.PLANNED, 0)),
        run_id=str(attrs.get(attempts.RUN_ID, "")),
        trials=tuple(places.values()),
        best=tuple(best if len(spec.values) > 1 else best[:1]),
    )


def _view(spec: ObjectiveDeclaration, trial: FrozenTrial) -> ObjectiveTrial:
    began, ended = trial.datetime_start, trial.datetime_complete
    return ObjectiveTrial(
        number=trial.number,
        state="failed" if trial.state == TrialState.FAIL else trial.state.name.lower(),
        params={**attempts.enqueued(trial), **trial.params},
        values=dict(zip(spec.values, trial.values or (), strict=False)),
        constraints=dict(trial.constraints),
        run_id=str(trial.user_attrs.get(attempts.RUN_ID, "")),
        wall_s=(ended - began).total_seconds() if began and ended else 0.0,
        reason=str(trial.user_attrs.get("reason", "")),
    )
