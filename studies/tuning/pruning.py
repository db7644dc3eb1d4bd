"""Which trials are stopped early: judged against the trials that are finished, without any storage."""

from collections.abc import Sequence

import optuna
from optuna.trial import Trial, create_trial
from optuna.trial import TrialState as OptunaState

from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord

N_SPARED_TRIALS = 4  # completed trials before the first may be pruned

_STATES = {"complete": OptunaState.COMPLETE, "pruned": OptunaState.PRUNED, "failed": OptunaState.FAIL}


class Pruner:
    """Compares one running trial with the finished ones.

    Args:
        spec: the study.
        index: the trial.
        finished: trials that it is compared with, in order.
    """

    def __init__(self, spec: StudySpec, index: int, finished: Sequence[TrialRecord]) -> None:
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        study = optuna.create_study(
            direction="minimize", pruner=optuna.pruners.MedianPruner(n_startup_trials=N_SPARED_TRIALS)
        )
        for record in finished:
            study.add_trial(
                create_trial(
                    state=_STATES[record.state],
                    value=record.value,
                    intermediate_values={int(step): value for step, value in record.reports.items()},
                )
            )
        study.add_trial(create_trial(state=OptunaState.RUNNING))
        self._trial = Trial(study, study.get_trials(deepcopy=False)[-1]._trial_id)

    def is_hopeless(self, epoch: int, value: float) -> bool:
        """Note the validation error at an epoch, and say whether the trial shall be pruned."""
        self._trial.report(value, epoch)
        return self._trial.should_prune()
