"""The project's own surrogates: every named variant as a user gets it, without a search."""

from pelsvae.config import VARIANTS
from pelsvae.training import fit
from surrogate_rivals.coordinates import Clock, Fitted
from surrogate_rivals.problems import Data


def variant(data: Data, seed: int, *, name: str) -> Fitted:
    """Train one of the named variants by the product's own `fit`."""
    clock = Clock()
    surrogate = fit(
        data.theta,
        data.y,
        data.validation,
        config=VARIANTS[name].replace(device="cpu"),
        seed=seed,
        log_columns=data.space.is_log,
        output_scales=data.output_scales,
        drive=data.drive,
    ).surrogate
    return Fitted(surrogate.predict, clock.s)
