"""Co-simulation: the FMU brings its own solver, and is driven from one communication step to the next."""

import ctypes
from functools import cache
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import make_ready
from simulation.fmi.instance import FmuInstance
from simulation.fmi.log import last_message
from simulation.fmi.loop import EARLY, ENDED, FUNCTIONS, step_through
from simulation.fmi.row_calls import RunPlan
from simulation.fmi.start import Start
from simulation.fmi.status import DISCARD, WARNING, Instance

# fmi2StatusKind that asks whether the FMU wants to end the simulation.
_TERMINATED = 3


@cache
def prepare() -> None:
    """Compile the loop, for whatever FMU, once in a process."""
    table, times = np.zeros((0, 6), dtype=np.intp), np.zeros(1)
    references = np.zeros(0, dtype=np.uint32)
    make_ready(step_through, table[:, 0].copy(), 0, table, references, times, 1, times, np.zeros((1, 0)))


def why_failed(instance: Instance, plan: RunPlan, status: int, name: str, step: int, reached: float) -> str:
    """Say why a row failed, and mark its instance as damaged where a call failed.

    Args:
        instance: The FMU.
        plan: What was stepped through.
        status: Of the last call, or ENDED or EARLY, see loop.
        name: Its function, without the version.
        step: Its step.
        reached: The time that an early return got to. [FMU's unit of time]

    Returns:
        One line; "" where the row is good.
    """
    if status <= WARNING:
        return ""
    time = plan.in_seconds(float(plan.edges[step]))
    if status == ENDED:
        return f"the FMU ended the simulation by itself in the step at {time:g} s{last_message(': {}')}"
    if status == EARLY:
        return f"the FMU returned early, at {plan.in_seconds(reached):g} s, from the step at {time:g} s"
    return instance.failure(name, status, time)


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
        prepare()

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        if failure := self._start.begin(values):
            return failure
        status, stage, step = step_through(*self._arguments(y))
        # FMI 3.0 says so by a flag of the step, FMI 2.0 by a discarded step and an answer when asked.
        if status == DISCARD and self._wants_to_end():
            status = ENDED
        return why_failed(
            self._instance, self._plan, status, self._names[stage], step, float(self._reached[0])
        )

    def _arguments(self, y: FloatArray) -> tuple[Any, ...]:
        """Return what the loop is called with."""
        plan, instance = self._plan, self._instance
        return (
            self._addresses,
            instance.component,
            self._start.input_table,
            plan.output_references,
            plan.edges,
            plan.scenario.output_every,
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
