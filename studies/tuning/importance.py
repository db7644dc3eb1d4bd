"""Which hyperparameters decided a study's errors: Optuna's PED-ANOVA on the trials' records."""

import warnings
from collections.abc import Sequence

import optuna
from optuna.importance import PedAnovaImportanceEvaluator
from optuna.trial import create_trial

from studies.tuning.coordinates import distributions
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord

N_LEAST_TRIALS = 6
"""With fewer trials the shares would be noise."""


def importances(spec: StudySpec, records: Sequence[TrialRecord]) -> dict[str, float]:
    """Return each hyperparameter's share of what separates the better trials from the others, sum 1.

    Args:
        spec: the study.
        records: its trials; a pruned one counts with its last error, which says that it was no good one.

    Returns:
        Shares by name in search coordinates; empty where too few trials tell.
    """
    judged = [record for record in records if record.state != "failed" and record.value is not None]
    space = {
        name: kind
        for name, kind in distributions(spec.search).items()
        if all(name in record.params for record in judged)
    }
    if len(judged) < N_LEAST_TRIALS or len({record.value for record in judged}) < 2 or len(space) < 2:
        return {}
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
        for record in judged:
            params = {name: record.params[name] for name in space}
            try:
                study.add_trial(create_trial(params=params, distributions=space, value=record.value))
            except ValueError:  # a configuration outside of the ranges, such as a known one that was enqueued
                continue
        if len(study.trials) < N_LEAST_TRIALS:
            return {}
        found = optuna.importance.get_param_importances(study, evaluator=PedAnovaImportanceEvaluator())
    return {name: float(share) for name, share in found.items()}
