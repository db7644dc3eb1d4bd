"""The validation period in the report: its record and its sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from simulation.time_unit import period_text
from studies.report.guideline14 import Judged, guideline_sentence, judged
from studies.report.records import CalibrationRecord, Floats, MeasuredSeries
from studies.report.wording import count, quantity


@dataclass(frozen=True)
class OutputFit:
    """How one simulated output differs from its measurement.

    Attributes:
        n_samples: Samples compared.
        rmse: Root mean square difference. [output's unit]
        bias: Mean of simulated minus measured. [output's unit]
        cv_rmse: rmse over the size of the mean measured value; None where that says nothing: for
            temperatures, whose zero is a convention, and for means of zero. [1]
        nmbe: bias over its size, positive where the model is too high; None likewise. [1]
    """

    n_samples: int
    rmse: float
    bias: float
    cv_rmse: float | None
    nmbe: float | None


@dataclass(frozen=True)
class ValidatedPoint:
    """One parameter set on both periods.

    Attributes:
        mse_window: Error over the calibrated window; None where the simulation does not report it, or failed.
            [first output's unit squared]
        mse: Error over the validation period, None where the simulation failed. [first output's unit squared]
        failure: Why it failed, "" when it did not.
        outputs: The fit by the outputs' names; empty where the simulation failed.
    """

    mse_window: float | None
    mse: float | None
    failure: str
    outputs: dict[str, OutputFit]


@dataclass(frozen=True)
class ValidationRecord:
    """One calibration on days that it did not see.

    Attributes:
        n_train: Size of the training set behind the calibration, 0 without one.
        period_d: The days. [d]
        measurement: What was measured there.
        y_screened: The physical model at the screened point, NaN if it failed. Shape (t, k).
        y_polished: The physical model at the polished point. Shape (t, k).
        points: The parameter sets by name ("estimate", "screened", "polished" or "calibrated"), the one that
            the calibration ended with last.
    """

    n_train: int
    period_d: tuple[float, float]
    measurement: MeasuredSeries
    y_screened: Floats
    y_polished: Floats
    points: Mapping[str, ValidatedPoint]

    def shown_as(self, calibration: CalibrationRecord) -> CalibrationRecord:
        """Return the calibration with the trajectories and errors of the validation period, to be drawn."""
        screened = self.points.get("screened")
        return replace(
            calibration,
            y_screened=self.y_screened,
            y_polished=self.y_polished,
            mse_screened=math.nan if screened is None or screened.mse is None else screened.mse,
            mse_polished=math.inf if self.final.mse is None else self.final.mse,
        )

    @property
    def final(self) -> ValidatedPoint:
        """The parameter set that the calibration ended with."""
        return list(self.points.values())[-1]

    def judged(self, point: ValidatedPoint) -> tuple[Judged, ...]:
        """Return a parameter set beside the limits of ASHRAE guideline 14."""
        return tuple(
            judged(self.measurement.measurement, k, self.measurement.units[k], fit.cv_rmse, fit.nmbe)
            for k, fit in enumerate(point.outputs.values())
        )

    @property
    def sentence(self) -> str:
        """Say what the calibrated parameters do on the period."""
        unit = self.measurement.mse_unit
        *others, (name, final) = self.points.items()
        on = f"On {period_text(self.period_d)}, which the calibration did not see, the {name} model"
        if final.mse is None:
            return f"{on} could not be simulated"
        beside = ", ".join(
            f"{other} {'failed' if point.mse is None else quantity(point.mse, unit)}"
            for other, point in others
        )
        return f"{on} has an MSE of {quantity(final.mse, unit)}{f' ({beside})' if beside else ''}"


def validation_caption(record: ValidationRecord) -> str:
    """Say how the parameter sets do on the validation period, and that no count includes its simulations."""
    simulated = count(len(record.points), "simulation")
    cost = f"The validation took {simulated}, which no count of calls includes."
    return " ".join(
        filter(None, [f"{record.sentence}.", guideline_sentence(record.judged(record.final)), cost])
    )
