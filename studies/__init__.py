"""What we ask of both: studies, tracking, calibration, reports, the command line, and its words in Python.

The functions do what the commands of their names do: `run`, `tune`, `calibrate`, `check`, `simulate`,
`sensitivity`, `uncertainty`, `choose`, `predict`, `report`, `best`, `compare`, `status`, `reproduce`.
`next_experiment` does what `studies next` does.
`load_case` reads a `Case` by its name, and a `Problem` is a case made of objects. What is wrong with a case,
a keyword or a file is an `InputError` of one line; a stage that fails is a `StageError`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simulation.case import Case as Case
    from simulation.errors import InputError as InputError
    from simulation.measurement import Measurement as Measurement
    from studies.api.calibrations import CalibrationResult as CalibrationResult
    from studies.api.calibrations import calibrate as calibrate
    from studies.api.chain import RunResult as RunResult
    from studies.api.chain import SensitivityResult as SensitivityResult
    from studies.api.chain import SimulationResult as SimulationResult
    from studies.api.chain import TuningResult as TuningResult
    from studies.api.chain import run as run
    from studies.api.chain import sensitivity as sensitivity
    from studies.api.chain import simulate as simulate
    from studies.api.chain import tune as tune
    from studies.api.judgements import CheckResult as CheckResult
    from studies.api.judgements import PredictionResult as PredictionResult
    from studies.api.judgements import ReportResult as ReportResult
    from studies.api.judgements import UncertaintyResult as UncertaintyResult
    from studies.api.judgements import UnsoundError as UnsoundError
    from studies.api.judgements import check as check
    from studies.api.judgements import predict as predict
    from studies.api.judgements import report as report
    from studies.api.judgements import uncertainty as uncertainty
    from studies.api.objectives import ObjectiveResult as ObjectiveResult
    from studies.api.planning import ChoiceResult as ChoiceResult
    from studies.api.planning import NextResult as NextResult
    from studies.api.planning import choose as choose
    from studies.api.planning import next_experiment as next_experiment
    from studies.api.problem import Problem as Problem
    from studies.api.projects import BestResult as BestResult
    from studies.api.projects import ComparisonResult as ComparisonResult
    from studies.api.projects import ProjectResult as ProjectResult
    from studies.api.projects import ReproductionResult as ReproductionResult
    from studies.api.projects import best as best
    from studies.api.projects import compare as compare
    from studies.api.projects import load_case as load_case
    from studies.api.projects import reproduce as reproduce
    from studies.api.projects import status as status
    from studies.calibration.polish import LeastSquaresTRF as LeastSquaresTRF
    from studies.calibration.problem import CalibrationProblem as CalibrationProblem
    from studies.task import StageError as StageError
    from studies.words.console import Console as Console

_MODULES = {
    "BestResult": "studies.api.projects",
    "CalibrationProblem": "studies.calibration.problem",
    "CalibrationResult": "studies.api.calibrations",
    "Case": "simulation.case",
    "CheckResult": "studies.api.judgements",
    "ComparisonResult": "studies.api.projects",
    "ChoiceResult": "studies.api.planning",
    "Console": "studies.words.console",
    "InputError": "simulation.errors",
    "LeastSquaresTRF": "studies.calibration.polish",
    "Measurement": "simulation.measurement",
    "NextResult": "studies.api.planning",
    "ObjectiveResult": "studies.api.objectives",
    "PredictionResult": "studies.api.judgements",
    "Problem": "studies.api.problem",
    "ProjectResult": "studies.api.projects",
    "ReportResult": "studies.api.judgements",
    "ReproductionResult": "studies.api.projects",
    "RunResult": "studies.api.chain",
    "SensitivityResult": "studies.api.chain",
    "SimulationResult": "studies.api.chain",
    "StageError": "studies.task",
    "TuningResult": "studies.api.chain",
    "UncertaintyResult": "studies.api.judgements",
    "UnsoundError": "studies.api.judgements",
    "best": "studies.api.projects",
    "calibrate": "studies.api.calibrations",
    "check": "studies.api.judgements",
    "choose": "studies.api.planning",
    "compare": "studies.api.projects",
    "load_case": "studies.api.projects",
    "next_experiment": "studies.api.planning",
    "predict": "studies.api.judgements",
    "report": "studies.api.judgements",
    "reproduce": "studies.api.projects",
    "run": "studies.api.chain",
    "sensitivity": "studies.api.chain",
    "simulate": "studies.api.chain",
    "status": "studies.api.projects",
    "tune": "studies.api.chain",
    "uncertainty": "studies.api.judgements",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """Import what is public when it is first used: numba and the rest take a second."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, for tab completion."""
    return sorted({*globals(), *__all__})
