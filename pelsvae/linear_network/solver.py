"""Outputs of linear networks from their elements, and what they owe to these; NumPy arrays, rows last."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pelsvae.linear_network import kernels
from pelsvae.linear_network.drive import Array, Drive
from pelsvae.linear_network.form import MOST_LOG, Form
from pelsvae.linear_network.kernels import Floats, Ints


class _Sparse(NamedTuple):
    """A matrix by its entries that are not zero."""

    rows: Ints
    columns: Ints
    factors: Array
    shape: tuple[int, ...]

    @classmethod
    def of(cls, matrix: Array) -> "_Sparse":
        rows, columns = np.nonzero(matrix)
        return cls(rows, columns, matrix[rows, columns], matrix.shape)

    def times(self, values: Floats) -> Array:
        """Return the matrix times values (columns, n)."""
        product = np.zeros((self.shape[0], values.shape[1]))
        kernels.combine(self.rows, self.columns, self.factors, values, product)
        return product

    def add_transposed(self, values: Floats, into: Array) -> None:
        """Add the transposed matrix times values (rows, n)."""
        kernels.combine(self.columns, self.rows, self.factors, values, into)


@dataclass(frozen=True, eq=False)
class Solution:
    """What `Solver.slopes` needs of a solved network. Shapes as of the kernels."""

    rates: Array
    is_limited: NDArray[np.bool_]
    a: Array
    b: Array
    of_outputs: Floats
    series: Array
    doubled: Array
    exponential: Floats
    walks: list[Floats]


class Solver:
    """Solves networks of one form under one drive, and gives the slopes of their outputs.

    Shapes: n rows, q elements, s states, r patterns, c inputs, e experiments, t x k values of a trajectory.
    """

    def __init__(self, form: Form, drive: Drive, inputs: Floats, pattern: Ints, n_times: int) -> None:
        """Lay out what does not change from one solution to the next.

        Args:
            form: Elements and how they make the matrices.
            drive: When the outputs are reported and where a trajectory holds them.
            inputs: In each communication step. Shape (m, c).
            pattern: Pattern of the switches in each step. Shape (m,).
            n_times: Times of a trajectory, t.
        """
        s, c = form.n_states, inputs.shape[1]
        self.form, self.step = form, drive.step
        self.inputs, self.pattern = np.ascontiguousarray(inputs, dtype=np.float32), pattern
        self.n_patterns = len(form.to_states) // s**2
        # Rows of A in the order in which the exponentials have them.
        to_states = form.to_states.reshape(self.n_patterns, s * s, -1).transpose(1, 0, 2)
        self._rates = _Sparse.of(form.makes)
        self._to_states = _Sparse.of(to_states.reshape(len(form.to_states), -1))
        self._to_inputs, self._to_outputs = _Sparse.of(form.to_inputs), _Sparse.of(form.to_outputs)
        self._shape_of_outputs = (len(form.summed), s + c)
        self._experiments = drive.experiments()
        n_reported = [reported.size for _, reported in self._experiments]
        ends = np.cumsum([0, *n_reported])
        self._parts = [slice(*pair) for pair in pairwise(ends.tolist())]
        # The first states are outputs as they are.
        self._as_it_is = [k for k in range(drive.n_outputs) if k not in form.summed]
        # Inputs that an output sees at the same time.
        self._seen = np.concatenate(
            [self.inputs[steps][np.maximum(reported - 1, 0)] for steps, reported in self._experiments]
        )
        self._shape_of_reported = (len(self._seen), drive.n_outputs)
        # Which reported output each value of a trajectory is; a shorter experiment keeps its last values,
        # as simulated rows do.
        self._source = np.empty((n_times, drive.columns.size), dtype=np.int64)
        for part, size, columns in zip(self._parts, n_reported, drive.columns, strict=True):
            at = part.start + np.minimum(np.arange(n_times), size - 1)
            self._source[:, columns] = at[:, None] * drive.n_outputs + np.arange(drive.n_outputs)
        self._source = self._source.ravel()

    def solve(self, elements: Array, first: Array) -> tuple[Floats, Solution]:
        """Solve a network for each row.

        Args:
            elements: Shape (q, n).
            first: States at the begin of each experiment. Shape (e, s, n).

        Returns:
            Outputs, shape (t k, n), and what their slopes need.
        """
        form, (_, n) = self.form, elements.shape
        n_logs, s, c, r = form.makes.shape[1], form.n_states, self.inputs.shape[1], self.n_patterns
        logarithms = self._rates.times(elements[:n_logs])
        is_limited = (logarithms < -MOST_LOG) | (logarithms > form.most)
        rates = np.exp(np.clip(logarithms, -MOST_LOG, form.most))
        made = np.concatenate([np.ones((1, n)), rates, elements[n_logs:]])
        a = self._to_states.times(made).reshape(s, s, r * n)
        b = self._to_inputs.times(made).reshape(r, s, c, n)
        of_outputs = self._to_outputs.times(made).reshape(*self._shape_of_outputs, n).astype(np.float32)
        norm = float(np.abs(a).sum(axis=1).max()) * self.step
        n_doublings = max(0, math.ceil(math.log2(max(norm, 1e-9) / kernels.MOST_NORM)))
        series, doubled = np.empty((kernels.N_TERMS, *a.shape)), np.empty((2, n_doublings + 1, *a.shape))
        kernels.exponentials(a, self.step, series, doubled)
        exponential, gains = np.empty((r, s, s, n), np.float32), np.empty((r, c, s, n), np.float32)
        kernels.discrete(doubled, b, exponential, gains)
        walks = list[Floats]()
        outputs = np.empty((*self._shape_of_reported, n), dtype=np.float32)
        for begin, part, (steps, reported) in zip(first, self._parts, self._experiments, strict=True):
            x = np.empty((steps.stop - steps.start + 1, s, n), dtype=np.float32)
            x[0] = begin
            kernels.walk(exponential, gains, self.inputs[steps], self.pattern[steps], x)
            walks.append(x)
            for state, output in enumerate(self._as_it_is):
                outputs[part, output] = x[reported, state]
            if form.summed:
                sums = np.einsum("lsn,tsn->tln", of_outputs[:, :s], x[reported])
                sums += np.einsum("lcn,tc->tln", of_outputs[:, s:], self._seen[part])
                outputs[part, form.summed] = sums
        y = outputs.reshape(-1, n)[self._source]
        return y, Solution(rates, is_limited, a, b, of_outputs, series, doubled, exponential, walks)

    def slopes(self, by_y: Floats, of: Solution) -> tuple[Array, Array]:
        """Return slopes of a number by elements and first states, from those by the outputs.

        Args:
            by_y: Shape (t k, n).
            of: What `solve` returned.

        Returns:
            Shapes (q, n), (e, s, n).
        """
        form, (r, s, _, n) = self.form, of.exponential.shape
        c = self.inputs.shape[1]
        by_outputs = np.zeros((*self._shape_of_reported, n), dtype=np.float32)
        kernels.add_rows(self._source, by_y, by_outputs.reshape(-1, n))
        by_walk, by_gains = np.zeros_like(of.exponential), np.zeros((r, c, s, n), dtype=np.float32)
        by_matrix, by_first = np.zeros(of.of_outputs.shape, dtype=np.float32), np.empty((len(of.walks), s, n))
        for place, (x, part, (steps, reported)) in enumerate(
            zip(of.walks, self._parts, self._experiments, strict=True)
        ):
            by_x = np.zeros_like(x)
            for state, output in enumerate(self._as_it_is):
                by_x[reported, state] = by_outputs[part, output]
            if form.summed:
                by_sums = by_outputs[part, form.summed]
                by_x[reported] += np.einsum("lsn,tln->tsn", of.of_outputs[:, :s], by_sums)
                by_matrix[:, :s] += np.einsum("tln,tsn->lsn", by_sums, x[reported])
                by_matrix[:, s:] += np.einsum("tln,tc->lcn", by_sums, self._seen[part])
            inputs, pattern = self.inputs[steps], self.pattern[steps]
            kernels.walk_adjoint(of.exponential, inputs, pattern, x, by_x, by_walk, by_gains)
            by_first[place] = by_x[0]
        by_exponential, by_integral = np.empty_like(of.a), np.empty_like(of.a)
        by_b = np.empty_like(of.b)
        kernels.discrete_adjoint(of.doubled, of.b, by_walk, by_gains, by_exponential, by_integral, by_b)
        by_a = kernels.exponentials_adjoint(
            of.a, self.step, of.series, of.doubled, by_exponential, by_integral
        )
        n_rates = len(of.rates)
        by_made = np.zeros((self._to_states.shape[1], n))
        self._to_states.add_transposed(by_a.reshape(-1, n), by_made)
        self._to_inputs.add_transposed(by_b.reshape(-1, n), by_made)
        self._to_outputs.add_transposed(by_matrix.reshape(-1, n).astype(np.float64), by_made)
        by_elements = np.zeros((len(form.mean), n))
        by_logarithms = np.where(of.is_limited, 0.0, by_made[1 : 1 + n_rates] * of.rates)
        self._rates.add_transposed(by_logarithms, by_elements)
        by_elements[form.makes.shape[1] :] = by_made[1 + n_rates :]
        return by_elements, by_first
