"""Model exchange: the FMU gives derivatives and events, and the solver is ours."""

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.errors import InputError
from simulation.fmi import exchange_calls as calls
from simulation.fmi import exchange_loop as loop
from simulation.fmi.description import FmuDescription
from simulation.fmi.exchange_cvode import Cvode, flag_in_words
from simulation.fmi.instance import FmuInstance
from simulation.fmi.start import RunPlan, Start

# OpenModelica's default, used where neither case nor FMU names a tolerance.
DEFAULT_TOLERANCE = 1e-6
# CVODE bounds the error of one step, and many steps add up. With a tenth of the tolerance the office stays
# within the tolerance of its exact solution: 3e-4 K of 300 K at 1e-6.
SHARE_OF_TOLERANCE = 0.1


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
        self._plan = plan
        self._start = start
        self._states = description.states
        self._names = (*calls.FUNCTIONS, *(one.function for one in (*start.inputs, *start.seen)))
        self._tolerance = SHARE_OF_TOLERANCE * (
            # What an FMU suggests is not checked before, and may be 0.
            plan.tolerance if plan.tolerance is not None and plan.tolerance > 0.0 else DEFAULT_TOLERANCE
        )
        self._table: IntArray = np.zeros(calls.SIZE, dtype=np.int64)
        self._table[: len(calls.FUNCTIONS)] = instance.addresses(*calls.FUNCTIONS)
        self._table[calls.N_STATES] = len(description.states)
        self._table[calls.N_INDICATORS] = description.n_event_indicators
        self._cvode = Cvode(
            self._table,
            relative_tolerance=self._tolerance,
            # Roots are sought at the ends of internal steps: a pair of events in a longer one is not seen.
            longest_step_s=float(np.max(np.diff(plan.edges))),
        )
        # CVODE starts anew only where an input changes: its first steps are short and of first order.
        is_change = np.any(plan.inputs[1:] != plan.inputs[:-1], axis=1)
        self._changes = np.append(1 + np.flatnonzero(is_change), plan.n_steps)

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        if failure := self._start.begin(values):
            return failure
        plan = self._plan
        self._table[calls.COMPONENT] = self._instance.component
        end, time = loop.simulate_row(
            self._table,
            self._start.input_table,
            self._start.seen_table,
            self._changes,
            plan.output_references,
            plan.edges,
            plan.output_every,
            self._tolerance,
            self._cvode.vectors,
            y,
        )
        return "" if end == loop.GOOD else self._reason(end, time)

    def _reason(self, end: int, time: float) -> str:
        """Return in one line why a simulation ended (see exchange_loop) at a time. [s]."""
        at, bad = f"at {time:g} s", int(self._table[calls.NOT_FINITE]) - 1
        failed = fault = ""
        if status := int(self._table[calls.STATUS]):
            failed = self._instance.failure(self._names[int(self._table[calls.STAGE])], status, time)
            fault = f"; {failed}"
        elif bad >= 0:
            fault = f"; the derivative of {self._states[bad]} is not finite"
        if end < 0:
            return f"{flag_in_words(end)} {at}{fault}"
        in_one = f"in one communication step {at}"
        return {
            loop.BAD_CALL: failed,
            loop.TOO_MANY_STEPS: f"the integrator needed more than {loop.MOST_STEPS} steps {in_one}{fault}",
            loop.TOO_MANY_EVENTS: f"the model had more than {loop.MOST_EVENTS} events {in_one}",
            loop.ENDED: f"the FMU asked to end the simulation {at}",
            loop.ENDLESS_ITERATION: f"the model's event did not settle "
            f"in {loop.MOST_ITERATIONS} iterations {at}",
            loop.BAD_STATE: f"state {self._states[bad] if bad >= 0 else ''} is not finite {at}",
            loop.STUCK: f"the integrator's steps became too small to get on {at}{fault}",
        }[end]
