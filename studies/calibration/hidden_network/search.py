"""A hidden network learnt during a calibration: it is fitted to the rows so far and proposes the next ones.

What it has not explained after the first design it leaves to the processes of the residuals.
"""

import numpy as np

from pelsvae.linear_network.drive import Drive
from pelsvae.linear_network.form import SCALE
from simulation.arrays import FloatArray, IntArray
from studies.calibration.hidden_network.fit import Fit, first_guess, improved
from studies.calibration.hidden_network.model import Network, NetworkForm
from studies.calibration.leader import Leader
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


class HiddenNetwork(Leader):
    """The hidden network of a calibration problem, as far as its rows show it."""

    NAME = "a network with hidden states"

    def __init__(self, inputs: Drive, problem: CalibrationProblem, seed: int) -> None:
        """Begin with nothing known.

        Args:
            inputs: What drives it.
            problem: The problem.
            seed: Seed of all draws.
        """
        self._form = NetworkForm.of(inputs, problem.space, len(problem.measurement.output_names))
        rng = np.random.default_rng([seed, self._form.n_elements])
        super().__init__(problem, rng, n_looks=N_NETWORK_LOOKS, n_walks=N_NETWORK_WALKS)
        self._y = np.empty((0, *np.shape(problem.measurement.time), self._form.n_outputs))
        self._fit: Fit | None = None

    def _keep(self, answer: Evaluation, good: IntArray) -> None:
        self._y = np.concatenate([self._y, answer.y[good]])

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
