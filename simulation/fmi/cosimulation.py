"""Co-simulation: the FMU brings its own solver, and is driven from one communication step to the next."""

import ctypes
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import make_ready
from simulation.fmi.instance import DISCARD, WARNING, FmuInstance
from simulation.fmi.log import last_message
from simulation.fmi.loop import (
    EARLY,
    ENDED,
    FIRST_INPUT,
    FUNCTIONS_2,
    FUNCTIONS_3,
    step_through_2,
    step_through_3,
)
from simulation.fmi.plan import RunPlan
from simulation.fmi.start import Start

# fmi2StatusKind that asks whether the FMU wants to end the simulation.
_TERMINATED: Final = 3


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
        self._inputs = start.inputs
        self._functions = FUNCTIONS_2 if instance.prefix == "fmi2" else FUNCTIONS_3
        self._addresses = instance.addresses(*self._functions)
        self._said = np.zeros(2)
        # Before the first row, whose time may be limited: compiling takes seconds where nothing is cached.
        loop, arguments = self._call(0, plan.n_steps, np.empty((plan.n_simulated, len(plan.outputs))))
        make_ready(loop, *arguments)

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
        plan, instance = self._plan, self._instance
        loop, arguments = self._call(first, last, y)
        status, stage, step = loop(*arguments)
        if status <= WARNING:
            return ""
        time = float(plan.edges[step])
        if status == ENDED or (status == DISCARD and self._wants_to_end()):
            said = f": {message}" if (message := last_message()) else ""
            return f"the FMU ended the simulation by itself in the step at {time:g} s{said}"
        if status == EARLY:
            return f"the FMU returned early, at {self._said[1]:g} s, from the step at {time:g} s"
        if stage >= FIRST_INPUT:
            return instance.failure(self._inputs.name(stage - FIRST_INPUT), status, time)
        return instance.failure(self._functions[stage], status, time)

    def _call(self, first: int, last: int, y: FloatArray) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Return the loop for these steps, and what to call it with."""
        plan, instance = self._plan, self._instance
        common = (
            self._addresses,
            instance.component,
            self._inputs.table,
            plan.output_references,
            plan.edges[: last + 1],
            first,
            plan.output_every,
            not instance.keeps_state,
        )
        if instance.prefix == "fmi2":
            return step_through_2, (*common, y)
        return step_through_3, (*common, self._said, y)

    def _wants_to_end(self) -> bool:
        """Ask an FMU of FMI 2.0 that discarded a step whether it wants no other."""
        answer = ctypes.c_int(0)
        if self._instance.prefix == "fmi3" or not self._instance.has("GetBooleanStatus"):
            return False
        status = self._instance.call("GetBooleanStatus", _TERMINATED, ctypes.addressof(answer))
        return status <= WARNING and bool(answer.value)


class SharedWarmup:
    """A Solver whose rows all start from the state at the end of one warm-up."""

    def __init__(self, simulation: CoSimulation, plan: RunPlan, start: Start, theta: FloatArray) -> None:
        """Say what is shared.

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
        self._y = np.empty((plan.n_simulated, len(plan.outputs)))

    def prepare(self) -> str:
        """Simulate the warm-up on a new instance; say why it failed."""
        failure = self._start.begin(self._theta) or self._simulation.step(0, self._first, self._y)
        return f"in the shared warm-up: {failure}" if failure else ""

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row from the end of the warm-up; see Solver."""
        time = float(self._plan.edges[self._first])
        failure = self._start.set_parameters(values, time)
        return failure or self._simulation.step(self._first, self._plan.n_steps, y)
