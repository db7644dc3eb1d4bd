"""What the studies of a user's objective have come to, read from Optuna alone."""

import optuna

from studies.paths import ProjectPaths
from studies.results.objective import ObjectiveDeclaration, TunedObjective, values_of
from studies.tuning import attempts
from studies.tuning.storage import storage_of
from studies.tuning.study_results import readable


def read_objectives(paths: ProjectPaths) -> list[TunedObjective]:
    """Read the studies of objectives of a project, the earliest first.

    Raises:
        InputError: the database is no longer as this program and Optuna have written it.
    """
    if paths.storage is None and not paths.optuna_database.is_file():
        return []
    with storage_of(paths) as storage, readable(paths):
        found = [
            read_objective(optuna.load_study(study_name=one.study_name, storage=storage))
            for one in storage.get_all_studies()
            if attempts.is_of_objective(one.user_attrs.get(attempts.DECLARATION))
            and one.user_attrs[attempts.DECLARATION].get("project", "") in ("", paths.identity)
        ]
    return sorted(found, key=lambda one: one.number)


def read_objective(study: optuna.Study) -> TunedObjective:
    """Return what a study has come to."""
    spec = attempts.declaration_of(study, ObjectiveDeclaration)
    # A constraint of a trial counts before its values; Optuna knows how.
    is_up = spec.values[0] in spec.maximize
    best = sorted(study.best_trials, key=lambda one: values_of(one)[0], reverse=is_up)
    return TunedObjective(
        spec,
        study._study_id,
        study.user_attrs,
        attempts.places(study.get_trials(deepcopy=False)),
        best if len(spec.values) > 1 else best[:1],
    )
