"""Where simulated outputs lie over a posterior sample: with and without the noise of a measurement."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from studies.calibration.uncertainty.noise import Noise
from studies.calibration.uncertainty.weights import quantiles

# They leave 1e-12 of the bracket, far less than a page shows.
N_HALVINGS = 40
"""Of the bracket in which a quantile of values with noise is sought."""


@dataclass(frozen=True, eq=False)
class Bands:
    """Lower and upper ends over time.

    Attributes:
        simulated: Of the simulated outputs: what the parameters leave open. Shape (2, t, k). [per output]
        predictive: Of a measurement: the same with noise. Shape (2, t, k). [per output]
    """

    simulated: FloatArray
    predictive: FloatArray


def bands_of(y: FloatArray, weights: FloatArray, noise: FloatArray, level: float) -> Bands:
    """Return the bands of a sample.

    Args:
        y: Simulated outputs. Shape (n, t, k). [per output]
        weights: What each member counts; sum 1. Shape (n,). [1]
        noise: Standard deviation of a measured value. Shape (k,). [per output]
        level: Share that shall lie within. [1]
    """
    shares = np.array([0.5 - 0.5 * level, 0.5 + 0.5 * level])
    n, t, k = y.shape
    simulated = quantiles(y.reshape(n, t * k), weights, shares).reshape(2, t, k)
    # Noise enters in closed form rather than by draws: the ends are smooth and need no seed.
    ends = [_noisy_quantile(y, weights, noise, share) for share in shares]
    return Bands(simulated, np.stack(ends))


def noise_of_outputs(noise: Noise, measurement: Measurement) -> FloatArray:
    """Return the standard deviation of a measured value of each output. Shape (k,). [per output].

    It is to its sensor's uncertainty as the others are; how an output is weighted and how often it is
    sampled say nothing about a single value of it.
    """
    uncertainty = np.asarray(measurement.uncertainty, dtype=np.float64)
    return np.asarray(noise.deviation * uncertainty / uncertainty[0])


def share_within(measurement: Measurement, ends: FloatArray, output: int) -> float:
    """Return the share of the samples of an output that lie between two trajectories.

    Args:
        measurement: What was measured.
        ends: Lower and upper one. Shape (2, t, k). [per output]
        output: Position of the output.
    """
    above, below = measurement.differences(ends, output)
    return float(np.mean((above <= 0.0) & (below >= 0.0)))


def _noisy_quantile(y: FloatArray, weights: FloatArray, noise: FloatArray, share: float) -> FloatArray:
    """Return a quantile of a mixture of normal densities, by halving. Shape (t, k). [per output]."""
    # Beyond nine deviations a normal tail holds 1e-19, so the bracket holds every quantile.
    reach = 9.0 * noise
    low, high = y.min(axis=0) - reach, y.max(axis=0) + reach
    for _ in range(N_HALVINGS):
        middle = 0.5 * (low + high)
        # The distribution function of the mixture rises everywhere, so halving cannot fail.
        below = np.tensordot(weights, ndtr((middle - y) / noise), axes=1)
        low, high = np.where(below < share, middle, low), np.where(below < share, high, middle)
    return 0.5 * (low + high)
