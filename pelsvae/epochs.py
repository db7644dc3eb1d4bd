"""What a training reports while it goes, and how it fails."""

from collections.abc import Mapping
from dataclasses import dataclass, field


class TrainingDiverged(RuntimeError):  # noqa: N818 - an outcome to expect, like a pruned trial
    """The loss or the validation error is no longer a finite number."""


@dataclass(frozen=True)
class EpochReport:
    """What a caller learns after each validated epoch.

    Attributes:
        epoch: Epochs done, from 1.
        max_epochs: Epochs at most.
        train_loss: Eq. 5, mean over the epoch's batches; of processes minus the logarithm of posterior
            density per row. [1]
        validation_mae: Mean absolute error on the validation set. [output's unit]
        terms: Terms of the training loss by name, such as "kl" and "reconstruction"; empty for processes. [1]
    """

    epoch: int
    max_epochs: int
    train_loss: float
    validation_mae: float
    terms: Mapping[str, float] = field(default_factory=dict)
