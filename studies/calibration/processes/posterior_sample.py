"""A function drawn from the posterior of the residual processes: residuals that the model may have.

A draw of the prior is corrected by what the rows add to it (Matheron's rule, doi 10.48550/arXiv.2002.09309,
Eq. 12); its bumps are a sum of random cosines (Rahimi and Recht, 2007).
"""

import operator
from dataclasses import dataclass
from functools import reduce
from typing import Self

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.kernel import CONSTANT
from studies.calibration.processes.process import ResidualProcess

# Cosines of a random function; by hand: they err by about one over the root of their number.
N_COSINES = 300


@dataclass(frozen=True, eq=False)
class _ProcessSample:
    """A draw of one process of r components over f features.

    Attributes:
        process: The process.
        frequencies: Of the cosines. Shape (c, f). [1]
        phases: Shape (c,). [rad]
        cosines: Their weights. Shape (c, r). [unit]
        slopes: Weights of the features. Shape (f, r). [unit]
        constants: Shape (r,). [unit]
        coefficients: Weights of the rows' kernels. Shape (n, r). [unit]
    """

    process: ResidualProcess
    frequencies: FloatArray
    phases: FloatArray
    cosines: FloatArray
    slopes: FloatArray
    constants: FloatArray
    coefficients: FloatArray

    @classmethod
    def of(cls, process: ResidualProcess, rng: np.random.Generator) -> Self:
        """Draw from a process."""
        x, (n, r) = process.x, process.coefficients.shape
        inverse_lengths, slope = np.exp(-process.hyper[:-2]), float(np.exp(process.hyper[-2]))
        amplitudes = process.amplitudes
        # A Gaussian kernel's spectral density is normal, with
        # the inverse lengths as deviations (Bochner's theorem).
        frequencies = rng.standard_normal((N_COSINES, x.shape[1])) * inverse_lengths
        phases = rng.uniform(0.0, 2.0 * np.pi, N_COSINES)
        # With this factor, cosines of random phases have the variance 1 in sum, as the kernel's bumps.
        cosines = np.sqrt(2.0 / N_COSINES) * rng.standard_normal((N_COSINES, r)) * amplitudes
        slopes = slope * inverse_lengths[:, None] * rng.standard_normal((x.shape[1], r)) * amplitudes
        constants = np.sqrt(CONSTANT) * rng.standard_normal(r) * amplitudes
        drawn = np.cos(x @ frequencies.T + phases) @ cosines + x @ slopes + constants
        of_functions = CONSTANT + 1.0 + slope**2 * (x * inverse_lengths) ** 2 @ np.ones(x.shape[1])
        # The diagonal holds kernel and noise of a row; the difference is its noise.
        noise = np.sqrt(np.maximum(np.diag(process.kernel) - of_functions, 0.0))
        drawn += noise[:, None] * rng.standard_normal((n, r)) * amplitudes
        # Matheron's rule: what the draw does at the rows, noise included, is replaced by what these answered.
        missing = process.inverse_factor.T @ (process.inverse_factor @ drawn)
        coefficients = process.coefficients - missing
        return cls(process, frequencies, phases, cosines, slopes, constants, coefficients)

    def expand(self, u: FloatArray) -> Expansion:
        """Expand the mean squared error of its components around a point (p,)."""
        process = self.process
        x = process.features.at(u)
        kernels, slopes = process.kernels_and_slopes(u)
        angles, m = self.frequencies @ x + self.phases, process.n_residuals
        residuals = process.level + np.cos(angles) @ self.cosines + x @ self.slopes + self.constants
        residuals = residuals + kernels @ self.coefficients
        mse = (process.outside + float(residuals @ residuals)) / m

        def derivatives() -> tuple[FloatArray, FloatArray]:
            jacobian = self.slopes - self.frequencies.T @ (np.sin(angles)[:, None] * self.cosines)
            pulled = process.features.pull_back(u, jacobian.T).T
            jacobian = pulled + slopes().T @ self.coefficients
            return 2.0 * (jacobian @ residuals) / m, 2.0 * (jacobian @ jacobian.T) / m

        return Expansion(mse, mse, derivatives)


@dataclass(frozen=True, eq=False)
class PosteriorSample:
    """A draw of all groups of residuals; make it with `draw`."""

    parts: tuple[_ProcessSample, ...]

    @classmethod
    def draw(cls, groups: ProcessGroups, rng: np.random.Generator) -> Self:
        """Draw a function of the parameters that may be the model's residuals."""
        return cls(tuple(_ProcessSample.of(process, rng) for process in groups.processes))

    def expand(self, u: FloatArray, caution: float = 0.0) -> Expansion:
        """Expand its mean squared error around a point (p,); it has no variance that caution could add."""
        return reduce(operator.add, (part.expand(u) for part in self.parts))
