"""The mean squared error above which a fit is not accepted as an answer."""

import math

# A tolerance alone had ended a search at 1098 times the
# best error (docs/notes/adaptive-search.md, First form).
SENSOR_UNCERTAINTIES = 2.0
"""A root mean square error of more than so many sensor uncertainties is no answer."""


def misfit_threshold(sensor: float) -> float | None:
    """Return the mean squared error above which a fit is no answer. [first output's unit squared].

    Args:
        sensor: Uncertainty of the first output's sensor; every fit is accepted where it is infinite, not
            known. [first output's unit]
    """
    return (SENSOR_UNCERTAINTIES * sensor) ** 2 if math.isfinite(sensor) else None
