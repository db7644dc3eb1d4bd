"""Prior knowledge of parameters, as a penalty that every solver minimizes beside the data's error.

The noise model: simulated and measured values of output k differ by its sensor's error, normal with standard
deviation s_k (`uncertainty`). Errors of neighbouring samples resemble each other as in a first-order
autoregressive process, with the time that an error lasts (`error_lasts_s`) as its correlation time tau_k;
where that is not declared, every sample counts. The m_k samples, dt_k apart (median), then are worth

    n_k = max(1, m_k (1 - rho_k) / (1 + rho_k)),    rho_k = exp(-dt_k / tau_k)

independent ones, n of all outputs together. A prior is normal in the parameter's own coordinate, which is the
logarithm where its scale is logarithmic: d_j counts the standard deviations from its centre. Then

    -2 log posterior = sum_k n_k mean_i (e_ki / s_k)^2 + sum_j d_j^2 + constant,

and with an output's share by weight in place of n_k / n the first sum is n / s_1^2 times the MSE (see
Measurement). So the most probable parameters (MAP) minimize

    objective = MSE + s_1^2 / n * sum_j d_j^2.

The penalty is in the MSE's unit and the same function of the parameters whichever model is asked. An error of
the model itself is neither in s nor in n: where it is large and slow, `error_lasts_s` says how long it lasts.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import InputError
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from studies.calibration.box_newton import Expansion


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known about parameters; make it with `of`.

    Attributes:
        centre: Most probable values in the unit cube, NaN where nothing is known. Shape (p,). [1]
        width: Standard deviations in the unit cube, infinite where nothing is known. Shape (p,). [1]
        weight: Penalty of a parameter one standard deviation away. [first output's unit squared]
        n_independent: Samples that count as independent.
    """

    centre: FloatArray
    width: FloatArray
    weight: float
    n_independent: float

    @classmethod
    def of(cls, space: ParameterSpace, measurement: Measurement) -> "Prior | None":
        """Return what the parameters declare, weighed against a measurement; None where none does.

        Args:
            space: The parameters.
            measurement: What they are calibrated with.

        Raises:
            InputError: If a sensor's uncertainty is unknown, so that nothing can be weighed.
        """
        beliefs = [parameter.prior for parameter in space.parameters]
        if not any(beliefs):
            return None
        for one in measurement.outputs:
            if not np.isfinite(one.uncertainty):
                raise InputError(
                    f"outputs[{one.name}]: a prior is weighed against the sensor's uncertainty, which is not "
                    "known; give uncertainty, or remove prior from the parameters"
                )
        centre = space.to_unit(np.array([np.nan if one is None else one.centre for one in beliefs]))
        width = np.full(space.n_parameters, np.inf)
        for j, (parameter, one) in enumerate(zip(space.parameters, beliefs, strict=True)):
            if one is not None:
                is_log = parameter.scale == "log"
                step, full = one.deviation, parameter.upper - parameter.lower
                # Of a logarithmic parameter, a deviation is declared as a factor.
                if is_log:
                    step, full = float(np.log(step)), float(np.log(parameter.upper / parameter.lower))
                width[j] = step / full
        n_independent = independent_samples(measurement)
        return cls(centre, width, float(measurement.uncertainty[0]) ** 2 / n_independent, n_independent)

    @cached_property
    def is_held(self) -> BoolArray:
        """Which parameters something is known about. Shape (p,)."""
        return np.isfinite(self.width)

    def deviations(self, u: FloatArray) -> FloatArray:
        """Return how far points lie from the centre, in standard deviations; 0 where nothing is known.

        Args:
            u: Points. Shape (n, p) or (p,). [1]

        Returns:
            Shape as u. [1]
        """
        return np.where(self.is_held, (u - self.centre) / self.width, 0.0)

    def penalty(self, u: FloatArray) -> FloatArray:
        """Return what the prior adds to the MSE.

        Args:
            u: Points. Shape (n, p). [1]

        Returns:
            Shape (n,). [first output's unit squared]
        """
        penalty: FloatArray = self.weight * np.sum(self.deviations(u) ** 2, axis=1)
        return penalty

    def rows(self, u: FloatArray, n_residuals: int) -> FloatArray:
        """Return residuals that make a sum of squares of n residuals that of the objective.

        Args:
            u: Points. Shape (n, p). [1]
            n_residuals: Residuals that the data have.

        Returns:
            One per parameter, 0 where nothing is known. Shape (n, p). [first output's unit]
        """
        # The MSE divides by the number of residuals, so that in
        # a sum of squares the penalty counts that many times.
        return float(np.sqrt(self.weight * n_residuals)) * self.deviations(u)

    def row_slopes(self, n_residuals: int) -> FloatArray:
        """Return the derivative of each parameter's residual by its coordinate. Shape (p,)."""
        return float(np.sqrt(self.weight * n_residuals)) * (1.0 / self.width)

    def expand(self, u: FloatArray) -> Expansion:
        """Expand the penalty around a point (p,): exactly, as it is a parabola."""
        d, slopes = self.deviations(u), 1.0 / self.width
        curvature = 2.0 * self.weight * np.diag(slopes**2)
        return Expansion.known(self.weight * float(d @ d), 0.0, 2.0 * self.weight * d * slopes, curvature)


def independent_samples(measurement: Measurement) -> float:
    """Return how many independent samples a measurement is worth under the module's noise model. [1]."""
    total = 0.0
    for k in measurement.measured:
        one, m, rho = measurement.outputs[k], len(measurement.outputs[k].samples.time), 0.0
        if m > 1 and one.error_lasts_s > 0.0:
            # The median: a gap in a recording must not make all samples seem to lie farther apart.
            rho = float(np.exp(-np.median(np.diff(one.samples.time)) / one.error_lasts_s))
        total += worth_of(m, rho)
    return total


def worth_of(m: int, rho: float) -> float:
    """Return how many independent samples m are worth that follow each other (first-order autoregressive).

    Args:
        m: Samples.
        rho: Correlation from one to the next. [1]
    """
    # The effective number of autocorrelated observations (Bayley and Hammersley 1946), for many samples.
    return max(1.0, m * (1.0 - rho) / (1.0 + rho))
