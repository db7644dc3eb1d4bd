"""What the studies of a project have come to, read from Optuna alone: for tables, figures and programs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.results.trials import TrialView, TunedStudy, errors_of
from studies.search_space import SearchSpace
from studies.tuning import attempts
from studies.tuning.storage import storage_of

MIN_FOR_IMPORTANCE = 4


def read_study(study: optuna.Study) -> TunedStudy:
    """Read a study.

    Raises:
        InputError: it was made by another program or version.
    """
    attrs = study.user_attrs
    return TunedStudy(
        spec=attempts.declaration_of(study),
        n_planned=int(attrs.get(attempts.PLANNED, 0)),
        trials=tuple(map(_view, attempts.places(study.get_trials(deepcopy=False)))),
        n_closed=int(attrs.get(attempts.CLOSED, 0)),
        gone=frozenset(map(str, attrs.get(attempts.GONE, ()))),
    )


def read_studies(paths: ProjectPaths, *, label: str | None = None) -> list[TunedStudy]:
    """Read the studies of a project, by label and size; those of other programs are left out.

    Args:
        paths: the project.
        label: only those of a label.
    """
    if paths.storage is None and not paths.optuna_database.is_file():
        return []
    found = []
    with storage_of(paths) as storage:
        for study in storage.get_all_studies():  # Optuna's summaries would read all trials once more
            declared = study.user_attrs.get(attempts.DECLARATION)
            # The label first: to read a study means to read all its trials.
            if not isinstance(declared, dict) or label not in (None, declared.get("label")):
                continue
            # Those of before have no project.
            if declared.get("project", "") in ("", paths.identity):
                found.append(read_study(optuna.load_study(study_name=study.study_name, storage=storage)))
    found.sort(key=lambda one: (one.spec.label, one.spec.n_train, one.spec.is_baseline, one.began_s))
    return found


def of_project(specs: Sequence[Declaration], paths: ProjectPaths) -> list[Declaration]:
    """Return declarations that are the project's own in a database that others share.

    A study of before, without a project, is gone on with.
    """
    if paths.storage is None or not paths.identity:
        return [*specs]
    with storage_of(paths) as storage:
        known = {one.study_name for one in storage.get_all_studies()}
    return [one if one.name in known else replace(one, project=paths.identity) for one in specs]


def latest_studies(
    studies: Sequence[TunedStudy], case_digest: str | None = None
) -> dict[tuple[int, bool], TunedStudy]:
    """Return the study begun last of each size, by size and whether it is the baseline.

    Args:
        studies: studies of one label.
        case_digest: only those of this physics.
    """
    mine = [s for s in studies if case_digest in (None, s.spec.digests.get("case"))]
    ordered = sorted(mine, key=lambda one: one.began_s)
    # In the order of their beginning, so the last of a size remains.
    return {(one.spec.n_train, one.spec.is_baseline): one for one in ordered}


def _view(trial: FrozenTrial) -> TrialView:
    training = trial.user_attrs.get("training", {})
    began = trial.datetime_start.timestamp() if trial.datetime_start else 0.0
    ended = trial.datetime_complete.timestamp() if trial.datetime_complete else 0.0
    # A trial without a value counts by its last error.
    last = None if trial.last_step is None else trial.intermediate_values[trial.last_step]
    value = last if trial.value is None else float(trial.value)
    # The worker notes a sampler only where it proposed from results.
    usual = "" if trial.state == TrialState.WAITING else "start-up"
    state = "failed" if trial.state == TrialState.FAIL else trial.state.name.lower()
    return TrialView(
        number=trial.number,
        state=state,
        params=dict(trial.params),
        value=value,
        metrics=errors_of(state, trial.value, trial.user_attrs),
        run_id=str(trial.user_attrs.get(attempts.RUN_ID, "")),
        proposed_by=str(trial.user_attrs.get("proposed_by", usual)),
        wall_s=float(training.get("wall_s", max(ended - began, 0.0) if ended else 0.0)),
        n_epochs=int(training.get("n_epochs", trial.last_step or 0)),
        best_epoch=int(training.get("best_epoch", 0)),
        began_s=began,
        weights_sha256=str(training.get("weights_sha256", "")),
        reported=dict(trial.intermediate_values),
    )


def importances(
    points: Sequence[Mapping[str, Any]], values: Sequence[float], space: SearchSpace
) -> dict[str, float]:
    """Return the part of the importance that each hyperparameter has, by Optuna's own evaluator.

    It is PED-ANOVA (Watanabe et al. 2023, arXiv:2304.10255). It compares where the best tenth of the points
    lies with where all lie. So only the order of the values counts.

    Args:
        points: hyperparameters by name.
        values: their errors, the least is the best; as many as points.
        space: the search space.

    Returns:
        Parts by name, which sum to 1, the largest first; empty with fewer than four points. [1]
    """
    if len(points) < MIN_FOR_IMPORTANCE or not space:
        return {}
    # In memory: the points of several studies and sizes are judged as one.
    study = optuna.create_study()
    for point, value in zip(points, values, strict=True):
        study.enqueue_trial(dict(point))
        trial = study.ask()
        for name, one in space.items():
            if name in point:
                one.suggest(trial, name)
        study.tell(trial, value)
    return dict(optuna.importance.get_param_importances(study))
