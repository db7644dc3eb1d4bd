"""What we ask of both: studies, tracking, calibration, reports, the command line, and its words in Python.

`run`, `tune` and `calibrate` do what the commands of these names do; a calibration is a `CalibrationResult`.
`load_case` reads a `Case` by its name. What is wrong with a case, a file or an option is an `InputError` of
one line; a stage that fails is a `StageError`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simulation.case import Case as Case
    from simulation.errors import InputError as InputError
    from studies.api import CalibrationResult as CalibrationResult
    from studies.api import calibrate as calibrate
    from studies.api import load_case as load_case
    from studies.api import run as run
    from studies.api import tune as tune
    from studies.task import StageError as StageError

_MODULES = {
    "CalibrationResult": "studies.api",
    "Case": "simulation.case",
    "InputError": "simulation.errors",
    "StageError": "studies.task",
    "calibrate": "studies.api",
    "load_case": "studies.api",
    "run": "studies.api",
    "tune": "studies.api",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """Import what is public when it is first used: pandas, numba and the rest take a second."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
