"""The mean of surrogates of one size, as an attribute of its studies keeps it."""

from dataclasses import dataclass, field
from typing import Literal

MIN_GAIN = 0.02
"""Part of the best trial's error that a mean has to take away; below, one surrogate is the simpler answer."""


@dataclass(frozen=True)
class MeanPart:
    """A surrogate of a mean.

    Attributes:
        kind: "trial", "confirmation" (a trial with a further seed) or "pca-gp".
        study: Its Optuna study.
        trial: Number of its trial.
        run_id: MLflow's run of it.
        share: What it counts; the shares of a mean sum to 1. [1]
        decoder: Its decoder.
        metrics: Its own errors by name. [first output's unit]
    """

    kind: Literal["trial", "confirmation", "pca-gp"]
    study: str
    trial: int
    run_id: str
    share: float
    decoder: str
    metrics: dict[str, float]

    @property
    def name(self) -> str:
        """What it is, in words."""
        if self.kind == "pca-gp":
            return "PCA + GP"
        return f"trial {self.trial}" + " of further seeds" * (self.kind == "confirmation")


@dataclass(frozen=True)
class BestMean:
    """The mean of least absolute error over the validation rows.

    Attributes:
        candidates: MLflow's runs of the surrogates that it was chosen from.
        parts: What counts in it; none where one trial alone was as good.
        run_id: MLflow's run of it.
        metrics: Its errors by name. [first output's unit]
        weights_sha256: Of its weights.
    """

    candidates: tuple[str, ...]
    parts: tuple[MeanPart, ...] = ()
    run_id: str = ""
    metrics: dict[str, float] = field(default_factory=dict)
    weights_sha256: str = ""

    def is_worth_it(self, error: float) -> bool:
        """Say whether it errs enough less than the best trial.

        Args:
            error: the trial's validation error. [first output's unit]
        """
        return bool(self.parts) and self.metrics["val/mae"] <= (1.0 - MIN_GAIN) * error


def shortened_model(model: str) -> str:
    """Return the words of `in_words` as they fit the cell of a table."""
    n_parts = model.count("×")
    return f"mean of {n_parts}" if n_parts else model


def in_words(parts: tuple[MeanPart, ...]) -> str:
    """Name a mean as what it is."""
    if len(parts) == 1:
        return parts[0].name
    return "mean of " + " + ".join(f"{one.share:.2f} × {one.name}" for one in parts)
