"""ASHRAE guideline 14 (2014): how far a calibrated building model may be off, and whether one is.

CV(RMSE), the root mean square difference over the size of the mean measured value, and NMBE, the mean
difference over it, are limited for energy and power by the interval at which they were measured; both sums
are divided by n - 1. Samples closer than an hour are judged by the hourly limits as far as that is safe:
their hourly means differ less, and by the same in the mean.
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from simulation.units import in_si
from studies.report.wording import difference_unit, percent
from studies.stages.stage_results import OutputFit

HOUR_S, DAY_S = 3600.0, 86400.0
ENERGY_OR_POWER = (
    (("kg", 1), ("m", 2), ("s", -2)),
    (("kg", 1), ("m", 2), ("s", -3)),
    (("kg", 1), ("s", -2)),
    (("kg", 1), ("s", -3)),
)
"""Energy and power, also per area: powers of the SI's base units."""
ON_TIME = 1.01


@dataclass(frozen=True)
class Limits:
    """What the guideline allows at an interval of measurement.

    Attributes:
        interval: The interval, in a word.
        cv_rmse: Largest CV(RMSE). [1]
        nmbe: Largest absolute NMBE. [1]
    """

    interval: str
    cv_rmse: float
    nmbe: float


HOURLY = Limits("hourly", 0.30, 0.10)
MONTHLY = Limits("monthly", 0.15, 0.05)


@dataclass(frozen=True)
class Judged:
    """One output on one period, beside the guideline's limits.

    Attributes:
        output: Name of the output.
        cv_rmse: CV(RMSE), None where a share of the mean says nothing. [1]
        nmbe: NMBE, None likewise. [1]
        limits: The limits, None where the guideline has none or where hourly means could keep them.
    """

    output: str
    cv_rmse: float | None
    nmbe: float | None
    limits: Limits | None

    @property
    def is_met(self) -> bool | None:
        """Whether both measures are within their limits, None without a verdict."""
        if self.limits is None or self.cv_rmse is None or self.nmbe is None:
            return None
        return self.cv_rmse <= self.limits.cv_rmse and abs(self.nmbe) <= self.limits.nmbe

    @property
    def sentence(self) -> str:
        """The verdict; "" without one."""
        if self.limits is None or self.cv_rmse is None or self.nmbe is None:
            return ""
        limits, verdict = self.limits, "met" if self.is_met else "not met"
        return (
            f"{self.output}: {limits.interval} limits {verdict}, CV(RMSE) {_tenths(self.cv_rmse)} (at most "
            f"{percent(limits.cv_rmse)}), NMBE {_tenths(self.nmbe)} (within ±{percent(limits.nmbe)})"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {**asdict(self), "is_met": self.is_met}


def judge(measurement: Measurement, units: Iterable[str], y: FloatArray) -> tuple[Judged, ...]:
    """Judge every output of a trajectory.

    Args:
        measurement: What it is compared with.
        units: Unit of each output.
        y: The trajectory, finite. Shape (t, k). [units]
    """
    return tuple(
        judged(measurement, k, unit, output_fit(measurement, k, unit, y)) for k, unit in enumerate(units)
    )


def guideline_sentence(found: Iterable[Judged]) -> str:
    """Say how a trajectory stands beside the guideline's limits, "" where it has none for any output."""
    said = "; ".join(one.sentence for one in found if one.sentence)
    return f"ASHRAE guideline 14: {said}." if said else ""


def output_fit(measurement: Measurement, output: int, unit: str, y: FloatArray) -> OutputFit:
    """Return how one output of a trajectory differs from its measurement.

    Args:
        measurement: What was measured.
        output: Position of the output.
        unit: Unit of the output.
        y: The trajectory, finite. Shape (t, k). [units]
    """
    difference = measurement.differences(y[None], output)[0]
    rmse, bias = float(np.sqrt(np.mean(difference**2))), float(np.mean(difference))
    values = measurement.samples[output].values
    # Of what is negative where it is taken out, as cooling is, the size counts.
    n, mean = len(values), abs(float(np.mean(values)))
    if _is_temperature(unit) or mean == 0.0 or n == 1:
        return OutputFit(n, rmse, bias, None, None)
    return OutputFit(n, rmse, bias, rmse / mean * math.sqrt(n / (n - 1)), bias / mean * n / (n - 1))


def judged(measurement: Measurement, output: int, unit: str, fit: OutputFit) -> Judged:
    """Put the limits beside measures that are known.

    Args:
        measurement: What was measured.
        output: Position of the output.
        unit: Unit of the output.
        fit: How it differs.
    """
    cv_rmse, nmbe = fit.cv_rmse, fit.nmbe
    name, time = measurement.output_names[output], measurement.samples[output].time
    if cv_rmse is None or nmbe is None or not _is_energy_or_power(unit):
        return Judged(name, cv_rmse, nmbe, None)
    step_s = float(np.median(np.diff(time)))
    if step_s <= HOUR_S * ON_TIME:
        found = Judged(name, cv_rmse, nmbe, HOURLY)
        # Means over an hour have the same NMBE and at most the CV(RMSE) of closer values.
        is_sure = found.is_met or abs(nmbe) > HOURLY.nmbe or step_s > HOUR_S / ON_TIME
        return found if is_sure else Judged(name, cv_rmse, nmbe, None)
    is_monthly = 28.0 * DAY_S / ON_TIME <= step_s <= 31.0 * DAY_S * ON_TIME
    return Judged(name, cv_rmse, nmbe, MONTHLY if is_monthly else None)


def _is_temperature(unit: str) -> bool:
    return difference_unit(unit) == "K" or unit == "degF"


def _is_energy_or_power(unit: str) -> bool:
    known = in_si(unit)
    return known is not None and known.exponents in ENERGY_OR_POWER


def _tenths(share: float) -> str:
    """Write a share with a tenth of a percent: limits are near."""
    return f"{100.0 * share:.1f} %"
