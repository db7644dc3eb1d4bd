"""Solvers that differentiate: one row's states at the start, and its trajectories with their derivatives."""

import ctypes
from pathlib import Path
from typing import Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.description import FmuDescription
from simulation.fmi.exchange import ModelExchange
from simulation.fmi.exchange_calls import SLOT
from simulation.fmi.exchange_loop import BAD_CALL, GOOD, begin
from simulation.fmi.instance import WARNING, FmuInstance
from simulation.fmi.plan import RunPlan
from simulation.fmi.restart import RestartingRunner
from simulation.fmi.sensitivity_calls import NOT_FINITE
from simulation.fmi.sensitivity_loop import HAS_EVENTS, simulate_sensitivities
from simulation.fmi.start import Start

# The estimate that is held against it is of the third order, the result of the fifth.
_TOLERANCE: Final = 1e-4
# Relative step of the central differences over the initialization: the cube root of the rounding error.
_STEP: Final = 6e-6


def open_exchange(
    description: FmuDescription, plan: RunPlan, folder: Path
) -> tuple[FmuInstance, ModelExchange, Start]:
    """Load an FMU for model exchange; InputError where that fails."""
    instance = FmuInstance(description, "model-exchange", folder)
    try:
        start = Start(instance, plan, str(description.path))
        return instance, ModelExchange(instance, plan, start, description=description), start
    except BaseException:
        instance.close()
        raise


class StartStates:
    """A Solver that initializes and gives the states at the start instead of outputs."""

    def __init__(self, instance: FmuInstance, exchange: ModelExchange, start: Start) -> None:
        self._instance = instance
        self._exchange = exchange
        self._start = start

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Fill y, shape (n,), with the states at the start; see Solver."""
        if failure := self._start.begin(values):
            return failure
        exchange, instance = self._exchange, self._instance
        exchange.table[SLOT.COMPONENT] = instance.component
        kind, detail, stage, _ = begin(exchange.table, np.zeros(4))
        if kind == GOOD:
            status = instance.call("GetContinuousStates", *_array(y))
            if status <= WARNING:
                return ""
            kind, detail, stage = BAD_CALL, status, SLOT.GET_STATES
        return exchange.reason(kind, detail, stage, float(exchange.plan.edges[0]))


class SensitivitySolver:
    """A Solver of outputs and, behind them, their derivatives; y has shape (t * k * (1 + p),)."""

    def __init__(
        self, instance: FmuInstance, exchange: ModelExchange, start: Start, start_states: RestartingRunner
    ) -> None:
        self._instance = instance
        self._exchange = exchange
        self._start = start
        self._start_states = start_states
        plan = exchange.plan
        self._states, self._slopes = exchange.state_references
        self._parameters = np.array([one.reference for one in plan.calibrated], dtype=np.uint32)
        self._acts = np.array([one.causality == "parameter" for one in plan.calibrated])
        tiled = np.tile(self._states, (len(plan.calibrated), 1))
        self._knowns = np.ascontiguousarray(np.column_stack([tiled, self._parameters]))

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver."""
        failure, s = self._slopes_of_start(values)
        if failure or (failure := self._start.begin(values)):
            return failure
        exchange = self._exchange
        plan, cvode = exchange.plan, exchange.cvode
        exchange.table[SLOT.COMPONENT] = self._instance.component
        nominal = self._nominal()
        # A change of a parameter by its own size that moves a state by its nominal value is nothing small.
        weights = _TOLERANCE * nominal[:, None] / size_of(values)
        n, k = plan.n_simulated, len(plan.outputs)
        kind, detail, stage, time = simulate_sensitivities(
            exchange.table,
            self._start.inputs.table,
            plan.inputs,
            plan.output_references,
            plan.edges,
            plan.output_every,
            exchange.tolerance,
            cvode.x,
            cvode.x_between,
            cvode.absolute,
            self._states,
            self._slopes,
            self._parameters,
            self._knowns,
            self._acts,
            s,
            weights,
            _TOLERANCE,
            y[: n * k].reshape(n, k),
            y[n * k :].reshape(n, k, -1),
        )
        if kind == GOOD:
            return ""
        if kind == HAS_EVENTS:
            return f"the model has an event at {time:g} s; trajectory sensitivities are for models without"
        if kind == NOT_FINITE:
            return f"the FMU's directional derivatives lead to no finite sensitivities at {time:g} s"
        return exchange.reason(kind, detail, stage, time)

    def _slopes_of_start(self, values: FloatArray) -> tuple[str, FloatArray]:
        """Differentiate the initialization; why it failed, and dx/dp at the start, shape (n, p)."""
        n, p = len(self._states), len(values)
        states, s = np.zeros((2, n)), np.zeros((n, p))
        for c, step in enumerate(_STEP * size_of(values)):
            shifted = np.stack([values, values])
            shifted[:, c] += (-step, step)
            for i in range(2):
                if failure := self._start_states.run(shifted[i], states[i]):
                    return failure, s
            s[:, c] = (states[1] - states[0]) / (shifted[1, c] - shifted[0, c])
        return "", s

    def _nominal(self) -> FloatArray:
        nominal = np.ones(len(self._states))
        status = self._instance.call("GetNominalsOfContinuousStates", *_array(nominal))
        wrong = ~np.isfinite(nominal) | (nominal == 0.0)
        return np.ones_like(nominal) if status > WARNING else np.where(wrong, 1.0, np.abs(nominal))


def _array(values: FloatArray) -> tuple[ctypes.c_void_p, ctypes.c_size_t]:
    return ctypes.c_void_p(values.ctypes.data), ctypes.c_size_t(values.size)


def size_of(values: FloatArray) -> FloatArray:
    """Return the magnitude that a parameter is changed by shares of: its own, 1 where it is 0. Shape (p,)."""
    return np.where(values == 0.0, 1.0, np.abs(values))
