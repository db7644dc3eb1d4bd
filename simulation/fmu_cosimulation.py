"""Co-simulation: the FMU brings its own solver, and is driven from one communication step to the next."""

from simulation.arrays import FloatArray
from simulation.fmu_instance import WARNING, FmuInstance
from simulation.fmu_loop import FUNCTIONS, step_through
from simulation.fmu_plan import RunPlan
from simulation.fmu_start import Start


class CoSimulation:
    """A Solver of co-simulation FMUs of FMI 2.0."""

    def __init__(self, instance: FmuInstance, plan: RunPlan, start: Start) -> None:
        """Look up the functions.

        Args:
            instance: The FMU.
            plan: What is set, stepped through and read.
            start: Sets the parameters and initializes.

        Raises:
            InputError: If the FMU's binary lacks a function.
        """
        self._instance = instance
        self._plan = plan
        self._start = start
        self._addresses = instance.addresses(*FUNCTIONS)

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        if failure := self._start.begin(values):
            return failure
        plan = self._plan
        status, stage, step = step_through(
            self._addresses,
            self._instance.component,
            plan.input_references,
            plan.inputs,
            plan.output_references,
            plan.edges,
            plan.output_every,
            y,
        )
        if status > WARNING:
            return self._instance.failure(FUNCTIONS[stage], status, float(plan.edges[step]))
        return ""
