"""A hidden network learnt during a calibration: it is fitted to the rows so far and proposes the next ones.

Solving the network costs no call, so the whole box is searched. It proposes while its points get better, and
what it has not explained after the first design it leaves to the processes of the residuals.
"""

import numpy as np

from pelsvae.linear_network.drive import Drive
from pelsvae.linear_network.form import SCALE
from simulation.arrays import FloatArray, IntArray
from studies.calibration.box_newton import SAME_POINT
from studies.calibration.descent import Descents
from studies.calibration.hidden_network.fit import Fit, first_guess, improved
from studies.calibration.hidden_network.model import Network, NetworkForm
from studies.calibration.problem import CalibrationProblem, Evaluation

# Most steps of the first fit, in parts, and of each later one; shares of the outputs' standard deviation that
# it may leave unexplained after the first part and at last.
FIRST_STEPS, LATER_STEPS = (20, 25), 15
EXPLAINED = (0.15, 0.03)  # those shares
# Latest rows that are fitted: the best and the last ones are among them.
MOST_FITTED = 48
# Points that are looked at, and how many of the best of them are walked downhill. By hand.
N_NETWORK_LOOKS, N_NETWORK_WALKS = 200, 16
# A row whose error is so many times the best counts half, in all fits but the first.
FAR_TIMES_BEST = 30.0
# It proposes where it expects to gain this part of the best error.
LITTLE_GAIN = 0.003
# After a round without gain a point costs its squared distance to the best row, times this part of the best
# error; the next such round raises the part by a factor, and a gain lowers it.
NEAR, NEARER = 0.3, 4.0
# Rounds without gain after which it gives up.
N_VAIN = 6
# Beside points that are known, others are drawn so far away. [1]
BESIDE = 0.05


class HiddenNetwork:
    """The hidden network of a calibration problem, as far as its rows show it."""

    def __init__(self, inputs: Drive, problem: CalibrationProblem, seed: int) -> None:
        """Begin with nothing known.

        Args:
            inputs: What drives it.
            problem: The problem.
            seed: Seed of all draws.
        """
        self._problem = problem
        self._form = NetworkForm.of(inputs, problem.space, len(problem.measurement.output_names))
        # Draws of its own leave those of the search as they are without a network.
        self._rng = np.random.default_rng([seed, self._form.n_elements])
        p = problem.space.n_parameters
        self._descents = Descents(problem.prior, p, N_NETWORK_WALKS)
        self._u = np.empty((0, p))
        self._y = np.empty((0, *np.shape(problem.measurement.time), self._form.n_outputs))
        self._objective = np.empty(0)
        self._fit: Fit | None = None
        self._n_vain = 0
        self._nearness = 0.0
        self._n_proposed = 0

    @property
    def is_believed(self) -> bool:
        """Whether it may propose points: not after rounds without gain."""
        return self._n_vain < N_VAIN

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked.

        Args:
            answer: The rows; failed ones teach nothing.
        """
        good = np.isfinite(answer.objective)
        best = float(self._objective.min(initial=np.inf))
        is_gain = bool((answer.objective < (1.0 - LITTLE_GAIN) * best).any())
        if self._n_proposed:
            self._n_vain = 0 if is_gain else self._n_vain + 1
            nearer = max(NEARER * self._nearness, NEAR)
            self._nearness = self._nearness / NEARER if is_gain else nearer
        self._u = np.concatenate([self._u, answer.u[good]])
        self._y = np.concatenate([self._y, answer.y[good]])
        self._objective = np.concatenate([self._objective, answer.objective[good]])

    def propose(self, n: int) -> FloatArray | None:
        """Return the points to ask next, None where it gives up and is asked no more. Shape (n, p). [1].

        Args:
            n: Points.
        """
        if not (self.is_believed and self._learn()):
            return None
        p = self._u.shape[1]
        looks = self._rng.random((N_NETWORK_LOOKS, p))
        rows = self._u[np.argsort(self._objective, kind="stable")]
        home, best_yet = rows[0], float(self._objective.min())
        cost = self._nearness * best_yet

        def with_distance(u: FloatArray) -> FloatArray:
            # Mean squares of the whole are those of the residuals, and the cost of the distance.
            residuals = self._residuals(u)
            m = residuals.shape[1]
            whole = [residuals / np.sqrt(m), np.sqrt(cost) * (u - home)]
            return np.asarray(np.concatenate(whole, axis=1) * np.sqrt(m + p))

        ends, values = self._descents.lowest(self._residuals, looks, rows, with_distance)
        points = np.empty((0, p))
        for end, value in zip(ends, values, strict=True):
            distance = np.abs(np.concatenate([self._u, points]) - end).max(axis=1).min()
            is_better = value < (1.0 - LITTLE_GAIN) * best_yet and distance > SAME_POINT
            if len(points) < n and is_better:
                points = np.concatenate([points, end[None]])
        if not len(points):
            return None
        beside = self._rng.uniform(-BESIDE, BESIDE, (n - len(points), p))
        self._n_proposed += 1
        return np.asarray(np.clip(np.concatenate([points, points[0] + beside]), 0.0, 1.0))

    def _learn(self) -> bool:
        """Fit the network to the rows so far; return whether it explains them."""
        rows = self._chosen_rows()
        u, y = self._u[rows], self._y[rows]
        if self._fit is not None:
            share = 1.0 / (1.0 + self._objective[rows] / (FAR_TIMES_BEST * self._objective.min()))
            self._fit = improved(self._fit, u, y, share, LATER_STEPS)
            return bool(self._fit.misfit <= EXPLAINED[0] * SCALE)
        deviation = float(y.std()) if len(y) else 0.0
        if deviation == 0.0:
            return False
        network = Network(self._form, self._form.mean, float(y[..., 0].mean()), SCALE / deviation)
        fit = first_guess(network, self._rng)
        for n_steps, share in zip(FIRST_STEPS, EXPLAINED, strict=True):
            fit = improved(fit, u, y, np.ones(len(u)), n_steps)
            if not fit.misfit <= share * SCALE:
                return False
        self._fit = fit
        return True

    def _chosen_rows(self) -> IntArray:
        """Return the positions of the best rows and the last ones."""
        n = len(self._u)
        if n <= MOST_FITTED:
            return np.arange(n)
        best = np.argsort(self._objective, kind="stable")[: MOST_FITTED // 2]
        return np.asarray(np.union1d(best, np.arange(n - MOST_FITTED // 2, n)), dtype=np.int64)

    def _residuals(self, u: FloatArray) -> FloatArray:
        """Return the residuals by the network at points (n, p). Shape (n, m). [first output's unit]."""
        assert self._fit is not None, "a network is fitted before it is solved"
        return self._problem.measurement.compared(self._fit.network.outputs(u))
