"""Processes for groups of the residuals' components, each with a kernel of its own.

The components that vary most, far from the measurement, say little of what moves the others, on which a
calibration ends: one kernel for all follows the former. Components are orthogonal, so that errors add up.
Where experiments have parameters that others lack, each has groups of its own, which depend on its own
parameters alone (docs/notes/adaptive-search.md, Experiments).
"""

import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple, Self

import numpy as np

from simulation.arrays import FloatArray, IntArray
from studies.calibration.box_newton import Expansion
from studies.calibration.problem import CalibrationProblem
from studies.calibration.processes.kernel import N_INDEPENDENT, Belief, most_probable
from studies.calibration.processes.process import Components, Features, ResidualProcess

# Components of the residuals far above this multiple of the best row's error count by their root.
# Over 60 runs this took 8 ± 4 % fewer calls to 1.17 times (docs/notes/adaptive-search.md, Truncated windows).
LARGE = 10.0
# Part of the differences' squares that the leading group holds.
# With two kernels, predictions in the valley err 0.65 to 0.98 times as much (the same note, Two kernels).
LEADING = 0.9
# A group's lengths have a prior around those of all components, with this part of the priors' deviations; a
# component counts as so many independent values in its likelihood.
CLOSER, PER_COMPONENT = 0.7, 2.0
# A row's noise falls with its error, in a single process with the error's root: a search only has to know its
# best rows, and far rows then distort their surroundings less.
NOISE_POWER, ERROR_NOISE_PRIOR = 2, (np.log(3e-2), 0.5)


# Hyperparameters are fitted again after one row for so many, and after each of the first ones: a fit takes
# some fifty factorizations, a round few. With 32, a search of 80 calls took 7 more
# (docs/notes/adaptive-search.md, Thinking between two simulations).
ROWS_PER_FIT = 64


def is_refitted(n_rows: int, n_fitted: int) -> bool:
    """Return whether so many rows are worth another fit of hyperparameters, after one to so many."""
    return not n_fitted or abs(n_rows - n_fitted) >= max(1, n_rows // ROWS_PER_FIT)


class Part(NamedTuple):
    """Residuals that depend on the same parameters.

    Attributes:
        features: The coordinates that their kernels see.
        outputs: Columns of the outputs that they are of. Shape (k,).
    """

    features: Features
    outputs: IntArray

    @classmethod
    def parts_of(cls, problem: CalibrationProblem) -> list[Self]:
        """Return one part for each experiment, or one for all where every parameter acts in each."""
        layout, space = problem.layout, problem.space
        if layout is None or all(one.parameters.size == space.n_parameters for one in layout.experiments):
            return [cls(Features.of(space), np.arange(len(problem.measurement.output_names)))]
        return [cls(Features.of(space, one.parameters), one.outputs) for one in layout.experiments]


@dataclass(frozen=True, eq=False)
class ProcessGroups:
    """The processes of the leading components and of the others; make it with `fit`.

    Attributes:
        processes: One per group.
        hyper: Hyperparameters of all components together, then of each group.
    """

    processes: tuple[ResidualProcess, ...]
    hyper: tuple[FloatArray, ...]

    @classmethod
    def fit(
        cls,
        features: Features,
        u: FloatArray,
        residuals: FloatArray,
        first_guess: tuple[FloatArray, ...] = (),
        *,
        balance: bool = False,
        n_noisy: int | None = None,
        n_residuals: int | None = None,
        refits: bool = True,
    ) -> Self:
        """Fit the processes to rows that were simulated.

        Args:
            features: The coordinates that the kernels shall see.
            u: Points, at least two. Shape (n, p). [1]
            residuals: Their residuals, finite, or coordinates of these in an orthonormal basis. Shape (n, m).
                [unit]
            first_guess: Hyperparameters of an earlier fit to start from.
            balance: Whether lengths are to suit small components of the residuals as well as large ones.
            n_noisy: So many rows, the first ones, have noise by their errors, the others all as little as
                the best row; None for all.
            n_residuals: Residuals in a row where coordinates are given, None for m.
            refits: Whether hyperparameters are fitted again, or those of the first guess taken.
        """
        x, components = features.at(u), Components.of(residuals, NOISE_POWER, n_residuals)
        if n_noisy is not None:
            looseness = components.looseness
            is_noisy = np.arange(len(u)) < n_noisy
            components = replace(components, looseness=np.where(is_noisy, looseness, looseness.min()))
        belief = Belief.of(x.shape[1], ERROR_NOISE_PRIOR)

        def hyper_of(group: Components, belief: Belief, place: int) -> FloatArray:
            guess = first_guess[place] if place < len(first_guess) else None
            if guess is not None and not refits:
                return guess
            values = balanced(group.values, group.best) if balance else group.values
            return most_probable(x, values, group.looseness, belief, guess)

        groups = components.split(LEADING)
        # All components go first: the groups' priors lie around these lengths.
        hyper = [hyper_of(components, belief, 0)]
        for place, group in enumerate(groups, start=1):
            n_independent = min(PER_COMPONENT * group.level.size, N_INDEPENDENT)
            closer = Belief(hyper[0], CLOSER * belief.deviation, n_independent)
            hyper.append(hyper_of(group, closer, place))
        through = zip(groups, hyper[1:], strict=True)
        processes = tuple(ResidualProcess.through(features, x, group, own) for group, own in through)
        return cls(processes, tuple(hyper))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join the groups of parts of the residuals, whose errors add up by their numbers of residuals."""
        m = sum(one.processes[0].n_residuals for one in parts)
        processes = (process for one in parts for process in one.processes)
        return cls(
            # Per residual of all parts; a process counts per residual of its own.
            tuple(
                replace(one, n_residuals=m, variance=one.variance * (one.n_residuals / m))
                for one in processes
            ),
            tuple(hyper for one in parts for hyper in one.hyper),
        )

    def expand(self, u: FloatArray, caution: float) -> Expansion:
        """Expand the expected error around a point.

        Args:
            u: The point. Shape (p,). [1]
            caution: Part of the predictive variance that is added to the squared mean. [1]
        """
        return reduce(operator.add, (process.expand(u, caution) for process in self.processes))

    def errors(self, u: FloatArray) -> FloatArray:
        """Return the mean squared errors at points (n, p) if the mean predictions are right. Shape (n,)."""
        errors: FloatArray = np.sum([process.errors(u) for process in self.processes], axis=0)
        return errors

    def covariance(self, u: FloatArray) -> FloatArray:
        """Return what the rows leave of the covariance of a residual at points (n, p). Shape (n, n)."""
        covariance: FloatArray = np.sum([process.covariance(u) for process in self.processes], axis=0)
        return covariance


def balanced(values: FloatArray, best: FloatArray) -> FloatArray:
    """Return components of rows whose large principal components are scaled down. Shape (n, k). [unit].

    What moves the residuals most would else decide alone, also the lengths of what hardly moves them.

    Args:
        values: The rows' components. Shape (n, r). [unit]
        best: Best row's residuals. Shape (m,). [unit]
    """
    directions, sizes, _ = np.linalg.svd(values, full_matrices=False)
    # Small components count in proportion, large ones by their root, with no step between.
    scale = np.sqrt(sizes**2 / len(values) + LARGE * float(best @ best) + np.finfo(float).tiny)
    return np.asarray(directions * (sizes / np.sqrt(scale)), dtype=np.float64)
