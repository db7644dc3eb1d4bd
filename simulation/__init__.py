"""How a physical model answers: cases, FMUs, designs, trajectories.

Read a case with `load_case`, a `Case` with its `Measurement` and its `ParameterSpace` of `Parameter`s. Any
`ForwardModel` answers parameter rows, as those of a `uniform_design`, with `Trajectories`: `FmuModel` in this
process, `PoolModel` in processes that may crash, `CountingModel` around another one, with a budget. What is
wrong with a file or an option is an `InputError` of one line.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simulation.case import Case as Case
    from simulation.case import load_case as load_case
    from simulation.counting import CountingModel as CountingModel
    from simulation.design import uniform_design as uniform_design
    from simulation.errors import InputError as InputError
    from simulation.fmi.fmu import FmuModel as FmuModel
    from simulation.forward_model import ForwardModel as ForwardModel
    from simulation.measurement import Measurement as Measurement
    from simulation.parameters import Parameter as Parameter
    from simulation.parameters import ParameterSpace as ParameterSpace
    from simulation.pool.pool_model import PoolModel as PoolModel
    from simulation.trajectories import Trajectories as Trajectories

if sys.platform != "linux":
    raise ImportError("simulations need Linux, for their locks, shared memory and processes; use a container")

_MODULES = {
    "Case": "case",
    "CountingModel": "counting",
    "FmuModel": "fmi.fmu",
    "ForwardModel": "forward_model",
    "InputError": "errors",
    "Measurement": "measurement",
    "Parameter": "parameters",
    "ParameterSpace": "parameters",
    "PoolModel": "pool.pool_model",
    "Trajectories": "trajectories",
    "load_case": "case",
    "uniform_design": "design",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """Import what is public when it is first used: all of it takes half a second."""
    if name in _MODULES:
        return getattr(import_module(f"simulation.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, for tab completion."""
    return sorted({*globals(), *__all__})
