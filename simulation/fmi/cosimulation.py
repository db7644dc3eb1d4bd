"""Co-simulation: the FMU brings its own solver, and is driven from one communication step to the next."""

import ctypes
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import make_ready
from simulation.fmi.instance import DISCARD, WARNING, FmuInstance
from simulation.fmi.log import last_message
from simulation.fmi.loop import EARLY, ENDED, FUNCTIONS, step_through
from simulation.fmi.start import RunPlan, Start

# fmi2StatusKind that asks whether the FMU wants to end the simulation.
_TERMINATED = 3


class CoSimulation:
    """A Solver of co-simulation FMUs."""

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
        self._names = (*FUNCTIONS, *(one.function for one in start.inputs))
        self._addresses = instance.addresses(*FUNCTIONS)
        self._reached = np.zeros(1)
        # Before the first row, whose time may be limited: compiling takes seconds where nothing is cached.
        make_ready(step_through, *self._arguments(0, plan.n_steps, plan.empty_y()))

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        return self._start.begin(values) or self.step(0, self._plan.n_steps, y)

    def step(self, first: int, last: int, y: FloatArray) -> str:
        """Take the initialized instance through some of the steps.

        Args:
            first: Step to begin with; a multiple of output_every.
            last: Step to stop before; a multiple of output_every.
            y: Filled with the outputs of these steps at their places, contiguous. Shape (n_simulated, k).
                [FMU's units]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        status, stage, step = step_through(*self._arguments(first, last, y))
        if status <= WARNING:
            return ""
        time = float(self._plan.edges[step])
        # FMI 3.0 says so by a flag of the step, FMI 2.0 by a discarded step and an answer when asked.
        if status == ENDED or (status == DISCARD and self._wants_to_end()):
            return f"the FMU ended the simulation by itself in the step at {time:g} s{last_message(': {}')}"
        if status == EARLY:
            return f"the FMU returned early, at {self._reached[0]:g} s, from the step at {time:g} s"
        return self._instance.failure(self._names[stage], status, time)

    def _arguments(self, first: int, last: int, y: FloatArray) -> tuple[Any, ...]:
        """Return what the loop is called with for these steps."""
        plan, instance = self._plan, self._instance
        return (
            self._addresses,
            instance.component,
            self._start.input_table,
            plan.output_references,
            plan.edges[: last + 1],
            first,
            plan.output_every,
            # noSetFMUStatePriorToCurrentPoint: without a saved state the FMU may drop what lies behind.
            int(not instance.keeps_state),
            self._reached,
            y,
        )

    def _wants_to_end(self) -> bool:
        """Ask an FMU of FMI 2.0 that discarded a step whether it wants no other."""
        answer = ctypes.c_int(0)
        if not self._instance.has("GetBooleanStatus"):
            return False
        status = self._instance.call("GetBooleanStatus", _TERMINATED, ctypes.addressof(answer))
        return status <= WARNING and bool(answer.value)


class SharedWarmup:
    """A Solver whose rows all start from the state at the end of one warm-up."""

    def __init__(self, simulation: CoSimulation, plan: RunPlan, start: Start, theta: FloatArray) -> None:
        """Prepare rows that share a warm-up.

        Args:
            simulation: Takes an initialized instance through steps.
            plan: What is set, stepped through and read.
            start: Sets the parameters and initializes.
            theta: Parameters of the warm-up. Shape (p,). [FMU's units]
        """
        self._simulation = simulation
        self._plan = plan
        self._start = start
        self._theta = theta
        self._first = plan.n_warmup * plan.output_every

    def prepare(self) -> str:
        """Simulate the warm-up on a new instance; return why it failed, "" when it did not."""
        y = self._plan.empty_y()
        failure = self._start.begin(self._theta) or self._simulation.step(0, self._first, y)
        return f"in the shared warm-up: {failure}" if failure else ""

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row from the end of the warm-up; see Solver."""
        time = float(self._plan.edges[self._first])
        # Parameters alone: the runner has set the state saved at the end of the warm-up.
        failure = self._start.set_parameters(values, time)
        return failure or self._simulation.step(self._first, self._plan.n_steps, y)
