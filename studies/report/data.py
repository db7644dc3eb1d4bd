"""What a whole report is made of: a case, what its stages came to, and how to get it again."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from simulation.arrays import FloatArray
from studies.report.records_tuning import TrialsRecord, TunedSize
from studies.sobol import SobolIndices
from studies.stages.pipeline import Outcome
from studies.stages.stage_results import Calibration, Uncertainty

if TYPE_CHECKING:  # numba and FMPy, which `studies best` does without
    from simulation.case import Case

Calibrations = tuple[Outcome[Calibration], ...]


@dataclass(frozen=True)
class ReportData:
    """Everything a report shows.

    Attributes:
        label: The study's label, e.g. "office-quick".
        case: What was calibrated, against what.
        calibrations: One per training-set size, the adaptive one first.
        coverage: Trajectories of the training set, NaN in failed rows; None without. Shape (n, t, k).
            [per output]
        sensitivity: Sobol indices, if they were asked for.
        tuned: The best surrogate of each training-set size.
        trials: Every trial of the studies.
        uncertainties: How sure the calibrations are, as far as that was asked.
        commands: What made the results.
    """

    label: str
    case: "Case"
    calibrations: Calibrations = ()
    coverage: FloatArray | None = None
    sensitivity: SobolIndices | None = None
    tuned: tuple[TunedSize, ...] = ()
    trials: TrialsRecord | None = None
    uncertainties: tuple[Uncertainty, ...] = ()
    commands: tuple[str, ...] = ()


def best_of(calibrations: Calibrations) -> Outcome[Calibration] | None:
    """Return the calibration of lowest MSE, of equals the cheapest; None without any."""
    return min(calibrations, key=lambda one: (one.result.mse, one.result.n_calls_paper), default=None)
