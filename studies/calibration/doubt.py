"""When an error is too large to be an answer."""

import math

DOUBT = 2.0
"""A root mean square error of more than so many sensor uncertainties is none."""


def doubtful_mse(sensor: float) -> float | None:
    """Return the mean squared error above which a fit is doubted. [first output's unit squared].

    Args:
        sensor: Uncertainty of the first output's sensor; where it is infinite, not known, no fit is doubted.
            [first output's unit]
    """
    return (DOUBT * sensor) ** 2 if math.isfinite(sensor) else None
