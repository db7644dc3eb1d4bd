"""State equations learnt from simulations: a model's trajectories all over the box, from a few of its rows.

    dx/dt = A(theta, w) x + B(theta, w) u + c(theta),    y = C(theta) (x, u, 1),

where w are inputs without unit that switch terms on and off. Terms are found in what the states did
(state_terms.py), and each one's coefficient is learnt over the parameters (coefficient.py). Trajectories
bend in many ways where coefficients do not: ten rows of an office with 14 parameters tell its trajectories
about as well as a thousand tell a surrogate that knows outputs alone. Whether a model moves so, the rows say.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import expm

from simulation.arrays import FloatArray
from simulation.states import StateRows, StateSignals
from studies.calibration.coefficient import Coefficient
from studies.calibration.state_terms import N_ROWS, N_TIMES, Term, candidates, chosen_terms, fitted, spread

# Sum of squares, as a share of all, that equations of a model that moves so leave.
LEARNT = 1e-9
# Standard deviation of a coefficient, as a share of itself, up to which a row tells it.
SURE = 1e-5
# Different values of the inputs that switch terms.
MOST_MODES = 64
# States at all steps that are held in memory at once.
MOST_VALUES = 4_000_000


@dataclass(frozen=True, eq=False)
class Sum:
    """A derivative or an output as a sum of terms.

    Attributes:
        own: Position of the state whose derivative it is, -1 for an output.
        terms: Its terms.
    """

    own: int
    terms: tuple[Term, ...]

    def values(self, x: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the terms over time: states (..., t, s), inputs (t, q). Shape (..., t, f)."""
        columns = np.concatenate([x, np.broadcast_to(inputs, (*x.shape[:-1], inputs.shape[-1]))], axis=-1)
        own = x[..., max(self.own, 0)]
        return np.stack([term.values(columns, own, inputs) for term in self.terms], axis=-1)


@dataclass(frozen=True, eq=False)
class Structure:
    """Which terms the equations have; make it with `of`.

    Attributes:
        sums: Of the s derivatives, then of the k outputs.
        misfit: Greatest share of squares that one of them leaves. [1]
    """

    sums: tuple[Sum, ...]
    misfit: float

    @classmethod
    def of(cls, signals: StateSignals, rows: StateRows) -> Self:
        """Find the terms.

        Args:
            signals: What is known of the states.
            rows: What they and the outputs did.
        """
        n_states = len(signals.states)
        plain = [Term(column) for column in range(n_states + len(signals.inputs))]
        everything = [Sum(j, tuple(candidates(signals, j))) for j in range(n_states)]
        everything += [Sum(-1, (*plain, Term(-1)))] * rows.y.shape[-1]
        sums, worst = list[Sum](), 0.0
        # A part of the rows, at a part of the times, tells the terms.
        some, times = spread(len(rows.x), N_ROWS), spread(len(signals.at_outputs), N_TIMES)
        x, inputs = rows.x[np.ix_(some, 1 + times)], signals.at_outputs[times]
        for all_terms, target in zip(everything, _targets(rows), strict=True):
            values = all_terms.values(x, inputs)
            chosen, misfit = chosen_terms(all_terms.terms, values, target[np.ix_(some, times)])
            sums.append(Sum(all_terms.own, tuple(all_terms.terms[one] for one in chosen)))
            worst = max(worst, misfit if np.isfinite(misfit) else np.inf)
            if worst > LEARNT:
                break
        return cls(tuple(sums), worst)

    def fitted(self, signals: StateSignals, rows: StateRows) -> tuple[list[FloatArray], float]:
        """Fit the coefficients of every row.

        Args:
            signals: What is known of the states.
            rows: What they and the outputs did.

        Returns:
            Coefficients of every sum, shapes (n, terms), NaN where a row leaves them open, and the greatest
            share of squares that is left. [1]
        """
        found, worst = list[FloatArray](), 0.0
        for one, target in zip(self.sums, _targets(rows), strict=True):
            values = one.values(rows.x[:, 1:], signals.at_outputs)
            fits = [fitted(value, goal) for value, goal in zip(values, target, strict=True)]
            doubt = np.array([fit.doubt for fit in fits])
            # In some rows one state follows another so closely that their terms cannot be told apart.
            is_open = doubt > np.maximum(SURE, np.median(doubt, axis=0))
            found.append(np.where(is_open, np.nan, np.array([fit.found for fit in fits])))
            worst = max([worst, *(fit.left if np.isfinite(fit.left) else np.inf for fit in fits)])
        return found, worst


def _targets(rows: StateRows) -> list[FloatArray]:
    """Return what the sums are fitted to, derivatives and outputs after the first time. Shapes (n, t - 1)."""
    return [*np.moveaxis(rows.slope[:, 1:], -1, 0), *np.moveaxis(rows.y[:, 1:], -1, 0)]


@dataclass(frozen=True, eq=False)
class StateEquations:
    """A model's state equations over its box; make them with `learn`.

    Attributes:
        signals: What is known of the states.
        structure: Their terms.
        by_term: Coefficients of every sum, in the order of its terms.
        start: States at the first output that is watched.
        switches: Inputs that terms are multiplied with.
    """

    signals: StateSignals
    structure: Structure
    by_term: tuple[tuple[Coefficient, ...], ...]
    start: tuple[Coefficient, ...]
    switches: tuple[int, ...]

    @classmethod
    def learn(
        cls,
        signals: StateSignals,
        structure: Structure,
        x: FloatArray,
        starts: FloatArray,
        found: Sequence[FloatArray],
    ) -> Self | None:
        """Learn coefficients and start states over the parameters.

        Args:
            signals: What is known of the states.
            structure: The terms.
            x: Features of the rows' parameters. Shape (n, f). [1]
            starts: States at the first output that is watched. Shape (n, s). [FMU's units]
            found: Coefficients of every row, from `Structure.fitted`.

        Returns:
            The equations, None where inputs switch them in too many ways.
        """
        switches = tuple(
            sorted({term.factor for one in structure.sums for term in one.terms if term.factor is not None})
        )
        if len(np.unique(signals.driven[:, list(switches)], axis=0)) > MOST_MODES:
            return None
        by_term = tuple(tuple(Coefficient.fit(x, column) for column in table.T) for table in found)
        start = tuple(Coefficient.fit(x, column) for column in starts.T)
        return cls(signals, structure, by_term, start, switches)

    def outputs(self, x: FloatArray) -> FloatArray:
        """Solve the equations.

        Args:
            x: Features of parameters. Shape (n, f). [1]

        Returns:
            Reported outputs, not finite where the equations run away. Shape (n, t, k). [per output]
        """
        # In pieces of so many points that the states of a long simulation fit into memory.
        per_point = len(self.signals.driven) * len(self.signals.states)
        n_at_once = max(MOST_VALUES // per_point, 1)
        pieces = [self._outputs(x[first : first + n_at_once]) for first in range(0, len(x), n_at_once)]
        return np.concatenate(pieces)

    def _outputs(self, x: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            states = self._states(x)
            n_states = len(self.signals.states)
            first = self.signals.driven[:1]
            inputs = np.concatenate([first, self.signals.at_outputs])
            answers = [
                np.einsum("ntf,nf->nt", one.values(states, inputs), self._at(j, x))
                for j, one in enumerate(self.structure.sums)
                if j >= n_states
            ]
        return np.stack(answers, axis=-1)[:, self.signals.n_before :]

    def _at(self, j: int, x: FloatArray) -> FloatArray:
        """Return the coefficients of sum j at features (n, f). Shape (n, terms)."""
        return np.stack([one.at(x) for one in self.by_term[j]], axis=-1)

    def _matrices(self, x: FloatArray) -> FloatArray:
        """Return the equations, unswitched and for each switch: (n, 1 + w, s, s + q + 1)."""
        n_states, n_inputs = len(self.signals.states), len(self.signals.inputs)
        matrices = np.zeros((len(x), 1 + len(self.switches), n_states, n_states + n_inputs + 1))
        for j in range(n_states):
            for term, values in zip(self.structure.sums[j].terms, self._at(j, x).T, strict=True):
                mode = 0 if term.factor is None else 1 + self.switches.index(term.factor)
                matrices[:, mode, j, term.column] += values
                if term.is_difference:
                    matrices[:, mode, j, j] -= values
        return matrices

    def _states(self, x: FloatArray) -> FloatArray:
        """Return the states at the outputs. Shape (n, t, s)."""
        signals, n_states = self.signals, len(self.signals.states)
        matrices = self._matrices(x)
        modes, mode_of = np.unique(signals.driven[:, list(self.switches)], axis=0, return_inverse=True)
        mode_of = mode_of.reshape(-1)
        # Over a step the inputs are constant: states and inputs together move by one matrix exponential.
        whole = np.zeros((len(modes), len(x), matrices.shape[-1], matrices.shape[-1]))
        for rank, mode in enumerate(modes):
            whole[rank, :, :n_states] = matrices[:, 0] + np.tensordot(matrices[:, 1:], mode, axes=(1, 0))
        is_wrong = ~np.isfinite(whole).all(axis=(0, 2, 3))
        whole[:, is_wrong] = 0.0
        steps = expm(whole * signals.step_s)[:, :, :n_states]
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
        by_input = by_input.transpose(0, 3, 2, 1).reshape(len(modes), -1, n_states * len(x))
        pushed = np.empty((len(driven), n_states, len(x)))
        for rank in range(len(modes)):
            is_so = mode_of == rank
            pushed[is_so] = (driven[is_so] @ by_input[rank]).reshape(-1, n_states, len(x))
        now = np.stack([one.at(x) for one in self.start])
        now[:, is_wrong] = np.nan
        states = np.empty((1 + len(driven), n_states, len(x)))
        states[0] = now
        for step, push in enumerate(pushed):
            now = np.add.reduce(own[mode_of[step]] * now[:, None], axis=0)
            now += push
            states[step + 1] = now
        return states[:: signals.every // n_skipped].transpose(2, 0, 1)
