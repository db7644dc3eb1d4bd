"""What a training reports while it goes, and how it fails."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


class TrainingDiverged(RuntimeError):  # noqa: N818 - an outcome to expect, like a pruned trial
    """The loss or the validation error is no longer a finite number."""


class StopTraining(Exception):  # noqa: N818 - a wish, as of a pruner, and no fault
    """Raised by a caller's `on_epoch`: the training ends here, with the best weights so far."""


@dataclass(frozen=True)
class EpochReport:
    """What a caller learns after each validated epoch.

    Attributes:
        epoch: Epochs done, from 1.
        max_epochs: Epochs at most.
        train_loss: Eq. 5, mean over the epoch's batches; of processes minus the logarithm of posterior
            density per row. [1]
        validation_mae: Mean absolute error on the validation set; NaN without one. [output's unit]
        terms: Terms of the training loss by name, such as "kl" and "reconstruction"; empty for processes. [1]
    """

    epoch: int
    max_epochs: int
    train_loss: float
    validation_mae: float
    terms: Mapping[str, float] = field(default_factory=dict)


class BestWeights:
    """Judges validated epochs, reports them, and keeps the weights of the best one."""

    def __init__(
        self, weights: "Sequence[Tensor]", max_epochs: int, on_epoch: Callable[[EpochReport], None] | None
    ) -> None:
        """Begin with the weights as they are.

        Args:
            weights: Changed in place by the training.
            max_epochs: Epochs at most.
            on_epoch: Called after each validated epoch.
        """
        self._weights, self._max_epochs, self._on_epoch = weights, max_epochs, on_epoch
        self._best = [weight.detach().clone() for weight in weights]
        self._least = math.inf
        self.epoch = 0  # the best one
        self.stopped = ""
        """Why the caller wants no further epoch; empty while it does."""

    def judge(
        self, epoch: int, mae: float | None, terms: "Sequence[float]", names: Sequence[str], remedy: str
    ) -> None:
        """Take note of a validated epoch.

        Args:
            epoch: Its number, from 1.
            mae: Its validation error; None without a validation set: the last epoch is then the best.
                [output's unit]
            terms: The loss, then its terms.
            names: Of the terms.
            remedy: What to change where it diverged.

        Raises:
            TrainingDiverged: A number is not finite.
        """
        loss, *parts = terms
        # Checked here, as no comparison with NaN is true: the training would go on unseen.
        rank = -float(epoch) if mae is None else mae
        if not all(map(math.isfinite, (loss, *parts, rank))):
            error = "" if mae is None else f", validation error {mae:g}"
            raise TrainingDiverged(f"loss {loss:g}{error} at epoch {epoch}; lower {remedy}")
        if rank < self._least:
            self._least, self.epoch = rank, epoch
            self._best = [weight.detach().clone() for weight in self._weights]
        if self._on_epoch is not None:
            by_name = dict(zip(names, parts, strict=True))
            judged = math.nan if mae is None else mae
            try:
                self._on_epoch(EpochReport(epoch, self._max_epochs, loss, judged, by_name))
            except StopTraining as wish:
                self.stopped = str(wish)

    def restore(self) -> None:
        """Put the best weights back."""
        for weight, value in zip(self._weights, self._best, strict=True):
            weight.detach().copy_(value)
