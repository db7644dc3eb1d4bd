"""Calibration: screened on a surrogate and polished on the physical model, or adaptive on it alone."""

from studies.calibration.adaptive import Adaptive, AdaptiveResult
from studies.calibration.direct import MultistartResult, best_known, multistart
from studies.calibration.ledger import Ledger
from studies.calibration.polish import LeastSquaresTRF, PolishResult
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import History, Progress
from studies.calibration.screen import DifferentialEvolution, ScreenResult
from studies.calibration.two_phase import CalibrationResult, calibrate_two_phase

__all__ = [
    "Adaptive",
    "AdaptiveResult",
    "CalibrationProblem",
    "CalibrationResult",
    "DifferentialEvolution",
    "Evaluation",
    "History",
    "LeastSquaresTRF",
    "Ledger",
    "MultistartResult",
    "PolishResult",
    "Prior",
    "Progress",
    "ScreenResult",
    "best_known",
    "calibrate_two_phase",
    "multistart",
]
