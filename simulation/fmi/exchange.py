"""Model exchange: the FMU gives derivatives and events, and the solver is ours."""

from typing import Final

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.fmi.exchange_calls import FIRST_INPUT, FUNCTIONS, SLOT
from simulation.fmi.exchange_cvode import Cvode, flag_in_words
from simulation.fmi.exchange_loop import (
    BAD_CALL,
    BAD_STEP,
    ENDED,
    ENDLESS_ITERATION,
    GOOD,
    MOST_EVENTS,
    MOST_ITERATIONS,
    MOST_STEPS,
    STUCK,
    TOO_MANY_EVENTS,
    TOO_MANY_STEPS,
    simulate_row,
)
from simulation.fmi.instance import FmuInstance
from simulation.fmi.plan import RunPlan
from simulation.fmi.start import Start

DEFAULT_TOLERANCE: Final = 1e-6
# CVODE bounds the error of one step, and many steps add up. With a tenth of the tolerance the office stays
# within the tolerance of its exact solution: 3e-4 K of 300 K at 1e-6.
SHARE_OF_TOLERANCE: Final = 0.1


class ModelExchange:
    """A Solver of model-exchange FMUs of FMI 2.0 and 3.0."""

    def __init__(
        self, instance: FmuInstance, plan: RunPlan, start: Start, *, description: FmuDescription
    ) -> None:
        """Look up the functions and set up CVODE.

        Args:
            instance: The FMU.
            plan: What is set, stepped through and read.
            start: Sets the parameters and initializes.
            description: What the FMU says of itself.

        Raises:
            InputError: If the FMU's binary lacks a function, or a state is an array.
        """
        for name in description.states:
            if description.variables[name].shape:
                raise InputError(
                    f"{description.path}: state {name} is an array, which model exchange cannot integrate; "
                    "export the FMU for co-simulation"
                )
        self._instance = instance
        self.plan = plan
        self._start = start
        self._states = description.states
        self._functions = FUNCTIONS[instance.prefix]
        self.tolerance = SHARE_OF_TOLERANCE * (
            plan.tolerance if plan.tolerance is not None and plan.tolerance > 0.0 else DEFAULT_TOLERANCE
        )
        self.table: IntArray = np.zeros(SLOT.SIZE, dtype=np.int64)
        self.table[: len(self._functions)] = instance.addresses(*self._functions)
        self.table[SLOT.IS_FMI3] = instance.prefix == "fmi3"
        self.table[SLOT.N_STATES] = len(description.states)
        self.table[SLOT.N_INDICATORS] = description.n_event_indicators
        self.cvode = Cvode(
            self.table,
            relative_tolerance=self.tolerance,
            longest_step_s=float(np.max(np.diff(plan.edges))),
        )

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        if failure := self._start.begin(values):
            return failure
        plan, cvode = self.plan, self.cvode
        self.table[SLOT.COMPONENT] = self._instance.component
        kind, detail, stage, time = simulate_row(
            self.table,
            self._start.inputs.table,
            plan.inputs,
            plan.output_references,
            plan.edges,
            plan.output_every,
            self.tolerance,
            cvode.x,
            cvode.x_between,
            cvode.absolute,
            y,
        )
        return "" if kind == GOOD else self.reason(kind, detail, stage, time)

    def reason(self, kind: int, detail: int, stage: int, time: float) -> str:
        """Say why a simulation did not reach its end.

        Args:
            kind: How it ended (see exchange_loop).
            detail: A detail of it.
            stage: The slot of the function at fault.
            time: Simulated time. [s]

        Returns:
            One line.
        """
        at = f"at {time:g} s"
        if kind == BAD_CALL:
            return self._instance.failure(self._name(stage), detail, time)
        if kind == BAD_STEP:
            return f"{flag_in_words(detail)} {at}{self._fault(time)}"
        if kind == STUCK:
            return f"the integrator's steps became too small to get on {at}{self._fault(time)}"
        if kind == TOO_MANY_STEPS:
            said = f"the integrator needed more than {MOST_STEPS} steps in one communication step {at}"
            return f"{said}{self._fault(time)}"
        if kind == TOO_MANY_EVENTS:
            return f"the model had more than {MOST_EVENTS} events in one communication step {at}"
        if kind == ENDED:
            return f"the FMU asked to end the simulation {at}"
        if kind == ENDLESS_ITERATION:
            return f"the model's event did not settle in {MOST_ITERATIONS} iterations {at}"
        return f"state {self._states[detail]} is not finite {at}"

    def _name(self, stage: int) -> str:
        """Return the function of a stage, without the version."""
        if stage >= FIRST_INPUT:
            return self._start.inputs.name(stage - FIRST_INPUT)
        return self._functions[stage]

    def _fault(self, time: float) -> str:
        """Say what CVODE met with in the FMU in this communication step, if anything."""
        if self.table[SLOT.FAILED_STATUS]:
            name = self._functions[self.table[SLOT.FAILED_STAGE]]
            return f"; {self._instance.failure(name, int(self.table[SLOT.FAILED_STATUS]), time)}"
        if self.table[SLOT.NOT_FINITE]:
            return f"; the derivative of {self._states[self.table[SLOT.NOT_FINITE] - 1]} is not finite"
        return ""
