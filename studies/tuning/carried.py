"""Trials of earlier studies that are trials of a new one, too, as where the search space was edited."""

from collections.abc import Iterator
from dataclasses import replace

import optuna
from optuna.storages import RDBStorage
from optuna.trial import FixedTrial, FrozenTrial, TrialState

from studies.results.declaration import Declaration
from studies.search_space import suggested
from studies.tuning import attempts


def carried_trials(storage: RDBStorage, spec: Declaration) -> Iterator[FrozenTrial]:
    """Yield the completed trials that a new study has from earlier ones, as trials of its search space.

    They have the same data, seed, sampler and pruner, and settings that a trial of the new study may have.

    Args:
        storage: Optuna's.
        spec: the new study.
    """
    taken = set[str]()
    for known in storage.get_all_studies() if spec.search else ():
        declared = known.user_attrs.get(attempts.DECLARATION)
        if not isinstance(declared, dict) or declared.get("label") != spec.label:
            continue
        study = optuna.load_study(study_name=known.study_name, storage=storage)
        if not spec.continues(before := attempts.declaration_of(study)):
            continue
        for trial in study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
            point = spec.point_of(replace(before, device=spec.device).config(trial.params))
            run_id = trial.user_attrs.get(attempts.RUN_ID)  # what a person added has none, and no weights
            if point is not None and run_id is not None and run_id not in taken:
                taken.add(run_id)
                yield _as_trial_of(spec, point, trial, f"trial {trial.number} of {known.study_name}")


def _as_trial_of(spec: Declaration, point: dict[str, object], trial: FrozenTrial, name: str) -> FrozenTrial:
    fixed = FixedTrial(point)
    suggested(fixed, spec.space, spec.base_config)
    # Of one that was carried before the first name stays.
    attrs = {attempts.CARRIED: name, **trial.user_attrs}
    attrs.pop(attempts.OWNER, None)
    # Another search space may have another default.
    if (is_default := point == spec.first_points[0]) or attrs.get(attempts.PROPOSED_BY) == "default":
        attrs[attempts.PROPOSED_BY] = "default" if is_default else "profile"
    return optuna.create_trial(
        value=trial.value,
        params=fixed.params,
        distributions=fixed.distributions,
        user_attrs=attrs,
        intermediate_values=trial.intermediate_values,
    )
