"""The validation period in the report: its record and its sentences."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from simulation.time_unit import period_text
from studies.report.guideline14 import Judged, guideline_sentence, judged
from studies.report.records import CalibrationRecord, Floats, MeasuredSeries, require_shape
from studies.report.wording import count, difference_unit, percent, quantity, squared


@dataclass(frozen=True)
class FitRecord:
    """One output of one parameter set on the validation period; NaN where nothing is known.

    Attributes:
        output: Name of the output.
        n_samples: Samples compared.
        rmse: Root mean square difference. [output unit, differences]
        bias: Mean of simulated minus measured. [output unit, differences]
        cv_rmse: rmse over the size of the mean measured value. [1]
        nmbe: bias over its size. [1]
    """

    output: str
    n_samples: int
    rmse: float
    bias: float
    cv_rmse: float = math.nan
    nmbe: float = math.nan


@dataclass(frozen=True)
class PointRecord:
    """One parameter set on both periods.

    Attributes:
        name: "estimate", "screened", "polished" or "calibrated".
        mse_window: MSE over the calibrated window, NaN where unknown. [first output unit squared]
        mse: MSE over the validation period, inf where the simulation failed. [first output unit squared]
        fits: One per output; empty where the simulation failed.
    """

    name: str
    mse_window: float
    mse: float
    fits: tuple[FitRecord, ...]


@dataclass(frozen=True)
class ValidationRecord:
    """One calibration on days that it did not see.

    Attributes:
        n_train: Size of the training set behind the calibration, 0 without one.
        period_d: The days. [d]
        measurement: What was measured there.
        y_screened: The physical model at the screened point, NaN if it failed. Shape (t, k).
        y_polished: The physical model at the polished point. Shape (t, k).
        points: The parameter sets, the one that the calibration ended with last.
        n_free: Parameters that were calibrated, None for all.
    """

    n_train: int
    period_d: tuple[float, float]
    measurement: MeasuredSeries
    y_screened: Floats
    y_polished: Floats
    points: tuple[PointRecord, ...]
    n_free: int | None = None

    def __post_init__(self) -> None:
        for what in ("y_screened", "y_polished"):
            require_shape(f"the validation's {what}", getattr(self, what), self.measurement.shape)

    def shown_as(self, calibration: CalibrationRecord) -> CalibrationRecord:
        """Return the calibration with the trajectories and errors of the validation period, to be drawn."""
        by_name = {point.name: point.mse for point in self.points}
        return replace(
            calibration,
            y_screened=self.y_screened,
            y_polished=self.y_polished,
            mse_screened=by_name.get("screened", math.nan),
            mse_polished=self.points[-1].mse,
        )

    def judged(self, point: PointRecord) -> tuple[Judged, ...]:
        """Return a parameter set beside the limits of ASHRAE guideline 14."""
        return tuple(
            judged(
                self.measurement.measurement,
                k,
                self.measurement.units[k],
                fit.cv_rmse if math.isfinite(fit.cv_rmse) else None,
                fit.nmbe if math.isfinite(fit.nmbe) else None,
            )
            for k, fit in enumerate(point.fits)
        )

    @property
    def sentence(self) -> str:
        """Say what the calibrated parameters do on the period."""
        unit = squared(difference_unit(self.measurement.units[0]))
        days = period_text(self.period_d)
        final = self.points[-1]
        if not math.isfinite(final.mse):
            return (
                f"On {days}, which the calibration did not see, the {final.name} model could not be simulated"
            )
        others = ", ".join(f"{point.name} {quantity(point.mse, unit)}" for point in self.points[:-1])
        return (
            f"On {days}, which the calibration did not see, the {final.name} model has an MSE of "
            f"{quantity(final.mse, unit)}{f' ({others})' if others else ''}"
        )


def validation_caption(record: ValidationRecord) -> str:
    """Say how the parameter sets do on the validation period, and that nobody counted its simulations."""
    unit = squared(difference_unit(record.measurement.units[0]))
    parts = [f"{record.sentence}."]
    window = record.points[-1].mse_window
    if math.isfinite(window):
        parts.append(f"On the calibrated part its MSE is {quantity(window, unit)}.")
    fits = []
    for fit, units in zip(record.points[-1].fits, record.measurement.units, strict=False):
        said = f"{fit.output} differs by {quantity(fit.rmse, difference_unit(units))} (root mean square)"
        if math.isfinite(fit.cv_rmse):
            said += f", CV(RMSE) {percent(fit.cv_rmse)}, NMBE {percent(fit.nmbe)}"
        fits.append(said)
    if fits:
        parts.append(f"{'; '.join(fits)}.")
        parts.append(guideline_sentence(record.judged(record.points[-1])))
    simulated = count(len(record.points), "simulation")
    parts.append(f"The validation took {simulated}, which no count of calls includes.")
    return " ".join(parts)
