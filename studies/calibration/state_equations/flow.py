"""State equations solved: exactly, step by step, where they are linear in the states, else by small steps.

Inputs are constant over a communication step. Equations that are linear then move by matrix exponentials;
others by the classical Runge-Kutta method of fourth order, in so many parts of a step that halving them would
not matter. Points share the cores; each one's numbers are the same whatever it is solved beside.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate
from typing import Self

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.pool.pool_model import available_cores
from studies.calibration.state_equations.states import StateSignals
from studies.calibration.state_equations.terms import Sum

# Different values of what terms are multiplied with, up to which a linear flow knows each one's exponential.
MOST_MODES = 64
# Products of matrices that an exponential takes.
EXPONENTIAL = 30
# Parts of a communication step, and the change by halving them that is small: relative to how a state moves,
# or to one that is at rest.
MOST_PARTS, SMALL_CHANGE, SMALL_AT_REST = 64, 1e-2, 1e-9
# The same where switches change, whose times errors move. With two parts instead of four a heat pump took
# four calls more for its last 7 % (docs/notes/state-equations.md, Switches).
SMALL_WITH_SWITCHES = 1e-3


@dataclass(frozen=True, eq=False)
class LinearFlow:
    """Equations that are linear in the states, solved by matrix exponentials; make it with `of`.

    Attributes:
        signals: What is known of the states.
        sums: The s derivatives.
        switches: Products of inputs that terms are multiplied with, each by the inputs' positions.
    """

    signals: StateSignals
    sums: tuple[Sum, ...]
    switches: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, signals: StateSignals, sums: tuple[Sum, ...]) -> Self | None:
        """Return the flow, None where it is not linear or changes too often."""
        switches = sorted({term.factors for one in sums for term in one.terms if term.factors})
        is_curved = any(term.function for one in sums for term in one.terms)
        if is_curved or any(factor < len(signals.states) for switch in switches for factor in switch):
            return None
        flow = cls(signals, sums, tuple(switches))
        return flow if len(flow._modes[0]) <= MOST_MODES else None

    @property
    def n_operations(self) -> int:
        """About what a solution takes."""
        n_states, n_all = len(self.signals.states), len(self.signals.states) + len(self.signals.inputs) + 1
        n_modes = len(self._modes[0])
        return len(self.signals.driven) * n_states * n_all + EXPONENTIAL * n_modes * n_all**3

    @cached_property
    def _modes(self) -> tuple[FloatArray, IntArray]:
        """Values of what terms are multiplied with, (k, w), and which of them every step has, (m,)."""
        driven, n_states = self.signals.driven, len(self.signals.states)
        products = [driven[:, np.array(switch) - n_states].prod(axis=1) for switch in self.switches]
        switched = np.array(products).reshape(-1, len(driven)).T
        modes, mode_of = np.unique(switched, axis=0, return_inverse=True)
        return modes, mode_of.reshape(-1)

    def states(self, start: FloatArray, rates: Sequence[FloatArray]) -> FloatArray:
        """Solve the equations.

        Args:
            start: First states. Shape (s, n).
            rates: Coefficients of every derivative's terms. Shapes (n, terms).

        Returns:
            The states at the outputs. Shape (n, t, s).
        """
        signals, n_states = self.signals, len(self.signals.states)
        matrices, n = self._matrices(rates), start.shape[1]
        # One exponential for each combination of switches instead of one for each step.
        modes, mode_of = self._modes
        # Only who needs it waits for numba.
        from studies.calibration.state_equations.flow_steps import exponentials, linear_steps

        # Over a step the inputs are constant.
        whole = np.stack([matrices[:, 0] + np.tensordot(matrices[:, 1:], one, axes=(1, 0)) for one in modes])
        whole *= signals.step_s
        is_wrong = ~np.isfinite(whole).all(axis=(0, 2, 3))
        # The states of these points become NaN below.
        whole[:, is_wrong] = 0.0
        steps = exponentials(whole.reshape(-1, *whole.shape[2:])).reshape(whole.shape)
        own, by_input = steps[..., :n_states], steps[..., n_states:]
        driven = np.concatenate([signals.driven, np.ones((len(signals.driven), 1))], axis=1)
        n_skipped = 1
        if len(modes) == 1:
            # From output to output at once: what is driven on the way moves on with the states.
            n_skipped, moved = signals.every, [by_input]
            for _ in range(n_skipped - 1):
                moved.append(own @ moved[-1])
            own, by_input = np.linalg.matrix_power(own, n_skipped), np.concatenate(moved[::-1], axis=-1)
            driven, mode_of = driven.reshape(-1, n_skipped * driven.shape[1]), mode_of[::n_skipped]
        # Points are the last axis: a step of all of them is a few operations on whole arrays.
        own = np.ascontiguousarray(own.transpose(0, 3, 2, 1))
        by_input = by_input.transpose(0, 3, 2, 1).reshape(len(modes), -1, n_states * n)
        # First what inputs add in every step, which the steps then add to the states before.
        states = np.empty((len(driven) + 1, n_states, n))
        states[0] = np.where(is_wrong, np.nan, start)
        pushed = states[1:].reshape(len(driven), -1)
        if len(modes) == 1:
            np.matmul(driven, by_input[0], out=pushed)
        else:
            for rank in range(len(modes)):
                is_so = mode_of == rank
                pushed[is_so] = driven[is_so] @ by_input[rank]
        # One layout of arrays: each other one would be compiled anew.
        linear_steps(states, own, np.ascontiguousarray(mode_of))
        return states[:: signals.every // n_skipped].transpose(2, 0, 1)

    def _matrices(self, rates: Sequence[FloatArray]) -> FloatArray:
        """Return the equations, unswitched and for each switch: (n, 1 + w, s, s + q + 1)."""
        n_states, n_inputs = len(self.signals.states), len(self.signals.inputs)
        matrices = np.zeros((len(rates[0]), 1 + len(self.switches), n_states, n_states + n_inputs + 1))
        for j, (one, coefficients) in enumerate(zip(self.sums, rates, strict=True)):
            for term, values in zip(one.terms, coefficients.T, strict=True):
                mode = 1 + self.switches.index(term.factors) if term.factors else 0
                matrices[:, mode, j, term.column] += values
                if term.is_difference:
                    matrices[:, mode, j, j] -= values
        return matrices


@dataclass(frozen=True, eq=False)
class SteppedFlow:
    """Equations with products, functions or switches, solved by the classical Runge-Kutta method.

    Attributes:
        signals: What is known of the states.
        sums: The s derivatives.
        rules: When switches change, see `flow_steps.steps`. Shape (r, 5).
        n_parts: Steps in a communication step.
    """

    signals: StateSignals
    sums: tuple[Sum, ...]
    rules: IntArray = field(default_factory=lambda: np.empty((0, 5), dtype=np.int64))
    n_parts: int = 1

    @property
    def n_operations(self) -> int:
        """About what a solution takes."""
        n_places = sum(3 + len(term.factors) for one in self.sums for term in one.terms)
        return 4 * len(self.signals.driven) * self.n_parts * n_places

    def fine_enough(self, start: FloatArray, rates: Sequence[FloatArray]) -> Self | None:
        """Return the flow with steps that solve some points' states well, None where that takes too many.

        Args:
            start: First states of the points. Shape (s, n).
            rates: Coefficients of every derivative's terms. Shapes (n, terms).
        """
        flow, coarse = self, self.states(start, rates)
        share = SMALL_WITH_SWITCHES if self.signals.n_switches else SMALL_CHANGE
        # Fixed parts instead of adaptive steps: differences of neighbouring points
        # must not see steps change (docs/notes/state-equations.md, Whole powers).
        while flow.n_parts < MOST_PARTS:
            flow = replace(flow, n_parts=2 * flow.n_parts)
            states = flow.states(start, rates)
            # Points that run away with any step say nothing of steps.
            is_known = np.isfinite(states).all(axis=(1, 2))
            # Switches jump: at an output next to a change they say nothing of steps.
            n = self.signals.n_continuous
            change = np.sqrt(np.mean((states - coarse)[is_known, :, :n] ** 2, axis=1))
            solved = states[is_known, :, :n]
            small = share * solved.std(axis=1) + SMALL_AT_REST * np.abs(solved).max(axis=1)
            if change.size and (change <= small).all():
                return flow
            coarse = states
        return None

    def states(self, start: FloatArray, rates: Sequence[FloatArray]) -> FloatArray:
        """Solve the equations.

        Args:
            start: First states. Shape (s, n).
            rates: Coefficients of every derivative's terms, shapes (n, terms), and of the rules, (n, 2 r).

        Returns:
            The states at the outputs. Shape (n, t, s).
        """
        signals, coefficients = self.signals, np.concatenate(rates, axis=1)
        n_threads = max(min(available_cores(), start.shape[1]), 1)

        def solved(rows: IntArray) -> FloatArray:
            points = start.T[rows], coefficients[rows]
            return self.solved(*points, signals.driven, signals.step_s, signals.every)

        # Threads are enough: compiled steps run without the interpreter's lock.
        with ThreadPoolExecutor(n_threads) as threads:
            parts = np.array_split(np.arange(start.shape[1]), n_threads)
            return np.concatenate([*threads.map(solved, parts)])

    def solved(
        self, start: FloatArray, coefficients: FloatArray, driven: FloatArray, step_s: float, every: int
    ) -> FloatArray:
        """Solve the equations from any start over any inputs, see `flow_steps.steps`. Shape (n, t, s)."""
        # Only who needs it waits for numba.
        from studies.calibration.state_equations.flow_steps import steps

        arrays = np.ascontiguousarray(start), coefficients, np.ascontiguousarray(driven), *self._terms
        return steps(*arrays, step_s, self.n_parts, every, self.rules)

    @property
    def unsolved(self) -> str:
        """Name of a function that terms have and compiled steps do not take, "" for none."""
        from studies.calibration.state_equations.flow_steps import SOLVED

        functions = (term.function for one in self.sums for term in one.terms if term.function)
        return next((name for name in functions if name not in SOLVED), "")

    @cached_property
    def _terms(self) -> tuple[IntArray, IntArray]:
        """Position after every derivative's last term, and where terms' parts are: see `flow_steps.steps`."""
        from studies.calibration.state_equations.flow_steps import SOLVED

        terms = [(one.own, term) for one in self.sums for term in one.terms]
        # Behind the inputs stand a 1 and a 0: with these, every term is a difference times as many factors.
        nothing = len(self.signals.states) + len(self.signals.inputs) + 1
        one, most = nothing - 1, max(len(term.factors) for _, term in terms)
        places = [
            (
                term.column if term.column >= 0 else one,
                own if term.is_difference else nothing,
                ("", *SOLVED).index(term.function),
                *term.factors,
                *[one] * (most - len(term.factors)),
            )
            for own, term in terms
        ]
        return np.array([*accumulate(len(one.terms) for one in self.sums)]), np.array(places, dtype=np.int64)
