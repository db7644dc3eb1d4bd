"""What a whole report is made of: the records of one study, their references and how to get them again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from simulation.parameters import ParameterSpace
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.records_tuning import TrialsRecord, TunedSize
from studies.report.uncertainty_record import UncertaintyRecord
from studies.report.validation import ValidationRecord

if TYPE_CHECKING:  # heavy, and only named here
    from simulation.case import KnownError
    from studies.sobol import SobolIndices


@dataclass(frozen=True)
class Provenance:
    """What it takes to get these numbers again; each entry is a pair of a name and a value, shown as given.

    Attributes:
        commands: Shell commands, in order.
        settings: Profile, budgets and seeds.
        digests: Digests of the case, the FMU, the sets, the surrogates.
        versions: Python, packages, platform.
    """

    commands: tuple[str, ...] = ()
    settings: tuple[tuple[str, str], ...] = ()
    digests: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class ReportData:
    """Everything a report shows. Only the measurement and the parameters are required.

    Attributes:
        label: The study's label, e.g. "office-quick".
        title: The case's title.
        note: The case's note (what must be known before reading a number), shown first; may be empty.
        measurement: What was calibrated against.
        parameters: What was calibrated.
        calibrations: One per training-set size, an adaptive one of size 0; any order.
        coverage: The training set to draw.
        sensitivity: Sobol indices, if they were asked for.
        tuned: The best surrogate of each training-set size.
        trials: Every trial of the studies.
        validations: The calibrations on the validation period, one per training-set size; empty without one.
        uncertainties: How sure the calibrations are, as far as that was asked.
        references: Known MSEs.
        provenance: How to do it again.
    """

    label: str
    title: str
    note: str
    measurement: MeasuredSeries
    parameters: ParameterSpace
    calibrations: tuple[CalibrationRecord, ...] = ()
    coverage: CoverageSet | None = None
    sensitivity: SobolIndices | None = None
    tuned: tuple[TunedSize, ...] = ()
    trials: TrialsRecord | None = None
    validations: tuple[ValidationRecord, ...] = ()
    uncertainties: tuple[UncertaintyRecord, ...] = ()
    references: tuple[KnownError, ...] = ()
    provenance: Provenance = Provenance()

    @property
    def headline(self) -> CalibrationRecord | None:
        """The calibration put first: the one of lowest MSE, of equals the cheapest; None without any."""
        return min(self.calibrations, key=lambda c: (c.mse_polished, c.calls_paper), default=None)

    def validation_of(self, calibration: CalibrationRecord) -> ValidationRecord | None:
        """Return how a calibration did on the validation period, None where there is none."""
        return next((v for v in self.validations if v.n_train == calibration.n_train), None)

    @property
    def by_size(self) -> tuple[CalibrationRecord, ...]:
        """The calibrations, the adaptive one first, then by training set."""
        return tuple(sorted(self.calibrations, key=lambda c: c.n_train))
