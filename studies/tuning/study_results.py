"""What the studies of a project have come to, read from Optuna alone: for tables, figures and programs."""

import json
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from simulation.errors import InputError
from simulation.foreign_text import shortened
from studies.paths import ProjectPaths
from studies.results.best_mean import BestMean
from studies.results.declaration import Declaration
from studies.results.saved import rebuilt
from studies.results.trials import TrialView, TunedStudy, joined
from studies.search_space import SearchSpace
from studies.tuning import attempts
from studies.tuning.storage import storage_of
from studies.tuning.stored_trials import stored_trials

if TYPE_CHECKING:
    from optuna.study._frozen import FrozenStudy

MIN_FOR_IMPORTANCE = 4
_MOST = 1e12


def read_study(study: "FrozenStudy", trials: Sequence[FrozenTrial]) -> TunedStudy:
    """Return what a study of these trials has come to.

    Raises:
        InputError: it was made by another program or version.
        ValueError: it holds what this program has not written.
    """
    attrs, spec = study.user_attrs, attempts.declaration_of(study)
    json.dumps(attrs, ensure_ascii=False).encode()  # which half a character has no form in
    mean = attrs.get(attempts.MEAN)
    return TunedStudy(
        spec=spec,
        number=study._study_id,
        n_planned=int(_bounded(attrs.get(attempts.PLANNED, 0))),
        trials=tuple(_view(spec, trial) for trial in attempts.places(trials)),
        n_closed=int(attrs.get(attempts.CLOSED, 0)),
        gone=frozenset(map(str, attrs.get(attempts.GONE, ()))),
        versions=dict(attrs.get(attempts.VERSIONS) or {}),
        mean=None if not mean else rebuilt(BestMean, mean, f"the Optuna study {study.study_name!r}"),
    )


def read_studies(
    paths: ProjectPaths, *, label: str | None = None, n_train: int | None = None
) -> list[TunedStudy]:
    """Read the studies of a project, by label and size; those of other programs are left out.

    Args:
        paths: the project.
        label: only those of a label.
        n_train: only those of a training-set size.

    Raises:
        InputError: the database is no longer as this program and Optuna have written it.
    """
    if paths.storage is None and not paths.optuna_database.is_file():
        return []
    found = []
    with storage_of(paths) as storage, readable(paths):
        for study in storage.get_all_studies():  # Optuna's summaries would read all trials once more
            declared = study.user_attrs.get(attempts.DECLARATION)
            # The label first: to read a study means to read all its trials.
            if not isinstance(declared, dict) or label not in (None, declared.get("label")):
                continue
            if attempts.is_of_objective(declared):
                continue
            if n_train not in (None, declared.get("n_train")):
                continue
            # Those of before have no project.
            if declared.get("project", "") in ("", paths.identity):
                found.append(read_study(study, stored_trials(storage, study._study_id)))
    found.sort(key=lambda one: (one.spec.label, one.spec.n_train, one.spec.is_baseline, one.number))
    return found


@contextmanager
def readable(paths: ProjectPaths) -> Iterator[None]:
    """Say in a line that studies cannot be read: what a stranger wrote reaches all of Optuna."""
    try:
        yield
    except (InputError, OSError):
        raise
    except Exception as error:
        where = paths.show(paths.optuna_database) if paths.storage is None else paths.storage
        said = shortened(next(iter(str(error).splitlines()), "") or type(error).__name__)
        raise InputError(
            f"{where}: a study or trial in it is damaged ({said}); restore it from a copy, or move it away"
        ) from error


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
    """Return what each size was tuned with last, by size and whether it is the baseline.

    Args:
        studies: studies of one label.
        case_digest: only those of this physics.
    """
    mine = [s for s in studies if case_digest in (None, s.spec.digests.get("case"))]
    # In the order of their beginning, so the last of a size remains.
    return {(one.spec.n_train, one.spec.is_baseline): one for one in joined_studies(mine)}


def joined_studies(studies: Iterable[TunedStudy]) -> list[TunedStudy]:
    """Return the studies of equal data as one each, those with which work went on last at the end."""
    equal: dict[tuple[Any, ...], list[TunedStudy]] = {}
    for one in sorted(studies, key=lambda one: one.number):
        key = (one.spec.is_baseline, *one.spec.data)
        equal[key] = [*equal.pop(key, []), one]
    return [joined(one) for one in equal.values()]


def _view(spec: Declaration, trial: FrozenTrial) -> TrialView:
    training = trial.user_attrs.get("training", {})
    began = trial.datetime_start.timestamp() if trial.datetime_start else 0.0
    ended = trial.datetime_complete.timestamp() if trial.datetime_complete else 0.0
    # A trial without a value counts by its last error.
    last = None if trial.last_step is None else trial.intermediate_values[trial.last_step]
    value = last if trial.value is None else float(trial.value)
    # The worker notes a sampler only where it proposed from results.
    usual = "" if trial.state == TrialState.WAITING else "start-up"
    state = "failed" if trial.state == TrialState.FAIL else trial.state.name.lower()
    if trial.state == TrialState.COMPLETE:
        if trial.value is None:
            raise ValueError(f"trial {trial.number} is complete without a value")
        spec.config(trial.params)  # which raises a ValueError where these are none of its surrogate's
    return TrialView(
        spec=spec,
        number=trial.number,
        state=state,
        # What was given to a trial that did not begin yet.
        params={**trial.system_attrs.get("fixed_params", {}), **trial.params}
        if spec.is_confirmation
        else dict(trial.params),
        value=value,
        metrics=spec.results_of(state, trial.values, trial.user_attrs),
        run_id=str(trial.user_attrs.get(attempts.RUN_ID, "")),
        proposed_by=str(trial.user_attrs.get("proposed_by", usual)),
        wall_s=_bounded(training.get("wall_s", max(ended - began, 0.0) if ended else 0.0)),
        n_epochs=int(_bounded(training.get("n_epochs", trial.last_step or 0))),
        best_epoch=int(_bounded(training.get("best_epoch", 0))),
        weights_sha256=str(training.get("weights_sha256", "")),
        reported=dict(trial.intermediate_values),
        carried_from=str(trial.user_attrs.get(attempts.CARRIED, "")),
    )


def _bounded(value: Any) -> float:
    """Return a duration or a count; sums of larger ones would not be finite."""
    if not 0.0 <= (number := float(value)) < _MOST:
        raise ValueError(f"{number:g} is no duration or count")
    return number


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
    with warnings.catch_warnings():
        # It leaves out a condition that a single trial has, and warns of each.
        warnings.filterwarnings("ignore", "Some regimes for parameter", UserWarning)
        return dict(optuna.importance.get_param_importances(study))
