"""Which trials are stopped early: judged against the trials that are finished, without any storage."""

import statistics
from collections.abc import Sequence

import optuna
from optuna.trial import Trial, create_trial
from optuna.trial import TrialState as OptunaState

from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord

N_SPARED_TRIALS = 4  # completed trials before the median may stop the first
CAUTION = 1.5  # how much more than any completed trial one may improve, divided by the number of those

PRUNED = {
    "catch-up": "could not catch up with the best trial any more",
    "median": "worse than the median of the completed trials",
}
"""Why a trial was stopped, by pruner."""

_STATES = {"complete": OptunaState.COMPLETE, "pruned": OptunaState.PRUNED, "failed": OptunaState.FAIL}


class Pruner:
    """Compares one running trial with the finished ones.

    "catch-up" stops a trial that would miss the best completed one even if its error fell from here on by a
    larger part than that of any completed trial: the largest part seen, times 1 + 1.5/n with n completed
    trials. So the rule learns from the trials themselves how much a schedule still brings at an epoch; with
    one-cycle that is most of the error early and nothing late. "median" is Optuna's pruner.

    Args:
        spec: the study; with several objectives nothing is stopped.
        finished: trials that it is compared with, in order.
    """

    def __init__(self, spec: StudySpec, finished: Sequence[TrialRecord]) -> None:
        self._least = float("inf")
        self._completed: Sequence[TrialRecord] = ()
        self._trial: Trial | None = None
        if len(spec.objectives) > 1 or spec.pruner == "none":
            return
        if spec.pruner == "median":
            self._trial = _beside(finished)
        else:
            self._completed = [record for record in finished if record.state == "complete"]

    def is_hopeless(self, epoch: int, value: float) -> bool:
        """Note the validation error at an epoch, and say whether the trial shall be stopped.

        Args:
            epoch: one of the epochs at which trials are compared.
            value: validation error there. [output's unit]
        """
        if self._trial is not None:
            self._trial.report(value, epoch)
            return self._trial.should_prune()
        self._least = min(self._least, value)
        parts = _parts_left(epoch, self._completed)
        if not parts:
            return False
        gain = (1.0 - min(parts)) * (1.0 + CAUTION / len(parts))
        best = min(record.metrics["val/mae"] for record in self._completed)
        return self._least * (1.0 - gain) > best


def expected_end(pruned: TrialRecord, completed: Sequence[TrialRecord]) -> float | None:
    """Return the error that a pruned trial was heading for, None where nothing is known of its way.

    Args:
        pruned: the trial.
        completed: trials that went on; half of them gained less from that epoch to their end, half more.
    """
    if not pruned.reports:
        return None
    parts = _parts_left(max(map(int, pruned.reports)), completed)
    return min(pruned.reports.values()) * statistics.median(parts) if parts else None


def _parts_left(epoch: int, completed: Sequence[TrialRecord]) -> list[float]:
    """Return each trial's error at its end as a part of its least error until an epoch."""
    least = [
        min((value for step, value in record.reports.items() if int(step) <= epoch), default=None)
        for record in completed
    ]
    return [record.metrics["val/mae"] / here for record, here in zip(completed, least, strict=True) if here]


def _beside(finished: Sequence[TrialRecord]) -> Trial:
    """Return a running trial in an Optuna study of the finished ones, in memory."""
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
    return Trial(study, study.get_trials(deepcopy=False)[-1]._trial_id)
