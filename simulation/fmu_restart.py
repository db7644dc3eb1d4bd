"""Every row as if it were the first: how an FMU is started over, and what is believed about that."""

from simulation.arrays import FloatArray
from simulation.fmu_instance import FmuInstance
from simulation.fmu_runner import Solver


class RestartingRunner:
    """Runs a solver row by row on one instance that is started over in between."""

    def __init__(self, instance: FmuInstance, solver: Solver) -> None:
        """Take over an instance.

        Args:
            instance: The FMU, just instantiated.
            solver: What takes it through one row.
        """
        self._instance = instance
        self._solver = solver
        self._used = False

    def run(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Runner."""
        if self._used and (self._instance.damaged or not self._instance.reset()):
            self._instance.replace()
        self._used = True
        reason = self._solver.solve(values, y)
        self._instance.damaged = reason != ""
        return reason

    def close(self) -> None:
        """Free the FMU."""
        self._instance.close()
