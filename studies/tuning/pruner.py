"""A pruner that learns from the completed trials how much a training still gains after an epoch."""

import optuna
from optuna.pruners import BasePruner
from optuna.trial import FrozenTrial, TrialState


class CatchUpPruner(BasePruner):
    """Stops a trial that could not catch up with the best one any more.

    It would miss the best completed trial even if its error fell from here on by a larger part than that of
    any completed trial: the largest part seen, times 1 + caution / n with n completed trials. With a
    one-cycle learning rate that part is large early in a training and nothing late, which a median ignores.

    Args:
        caution: how much more than any completed trial one may still gain, divided by their number.
    """

    def __init__(self, caution: float = 1.5) -> None:
        self._caution = caution

    def prune(self, study: optuna.Study, trial: FrozenTrial) -> bool:
        """Say whether the trial is to be stopped, judged by what it has reported."""
        step = trial.last_step
        if step is None:
            return False
        complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        parts = [
            other.value / least
            for other in complete
            if other.value is not None and (least := least_until(other, step)) is not None
        ]
        least = least_until(trial, step)
        if not parts or least is None:
            return False
        gain = (1.0 - min(parts)) * (1.0 + self._caution / len(parts))
        return least * (1.0 - gain) > min(other.value for other in complete if other.value is not None)


def least_until(trial: FrozenTrial, step: int) -> float | None:
    """Return the least value that a trial reported up to a step, None where it reported none."""
    return min((value for at, value in trial.intermediate_values.items() if at <= step), default=None)
