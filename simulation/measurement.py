"""What was measured, when, and how simulated outputs are compared with it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray, digest_of
from simulation.correlated_error import coloured, correlations, whitened
from simulation.limits import Limits
from simulation.robust_loss import RobustLoss
from simulation.samples import Place, Samples, place_of


@dataclass(frozen=True, eq=False)
class Measurement:
    """The target of a calibration.

    Simulated outputs are compared at the sample times, by straight lines between output times; a gap has no
    residual. With sample i of output k, its m_k samples in all, uncertainty s_k and weight w_k, the error is

        MSE = sum_k w_k / sum_k w_k * mean_i (s_1 / s_k * (simulated_ki - measured_ki))^2

    in the first output's unit squared: every output has the same say per weight, however often it was
    sampled.
    For one output, or outputs sampled alike with weights of 1, this is the mean of all squared residuals.
    For an output with a robust loss, the square of the difference is replaced by its loss: the error is then
    a mean loss.
    For an output whose errors have a correlation time, the differences are replaced by their innovations
    (see `correlated_error`), so that the sum of squares is that of the likelihood.
    An output with limits adds w_k / sum_k w_k * mean_i (s_1 / s_k * excess_ki)^2 over the output times. Where
    it has no measurement its weight is in no sum_k w_k: limits that are kept leave the error as it is.

    Attributes:
        time: Output times. Shape (t,). [s]
        samples: What was measured of each of the k outputs, within the output times.
        output_names: Names of the outputs.
        uncertainty: Uncertainty of the sensors. Shape (k,). [per output]
        weights: Share of the MSE that each output has, relative to the others. Shape (k,). [1]
        lasts_s: How long an error of each output lasts, None where that is not known: it decides how much a
            prior weighs, and no error. Shape (k,). [s]
        losses: Robust loss of each output, None for squares; empty for squares throughout.
        correlation_s: Correlation time of each output's errors, 0 for independent ones; None for independent
            ones throughout. Shape (k,). [s]
        limits: Limits of each output, None for none; empty for none throughout. Samples of an output that
            has nothing else are its limit.
    """

    time: FloatArray
    samples: tuple[Samples, ...]
    output_names: tuple[str, ...]
    uncertainty: FloatArray
    weights: FloatArray
    lasts_s: FloatArray | None = None
    losses: tuple[RobustLoss | None, ...] = ()
    correlation_s: FloatArray | None = None
    limits: tuple[Limits | None, ...] = ()

    def __post_init__(self) -> None:
        n_outputs = len(self.output_names)
        n_losses, n_limits = len(self.losses) or n_outputs, len(self.limits) or n_outputs
        sizes = {len(self.samples), *self.uncertainty.shape, *self.weights.shape, n_losses, n_limits}
        if sizes != {n_outputs}:
            raise ValueError(
                f"{len(self.samples)} series of samples, uncertainty {self.uncertainty.shape}, weights "
                f"{self.weights.shape}, {n_losses} losses, {n_limits} limits do not fit {n_outputs} outputs"
            )
        if not len(self.measured):
            raise ValueError("no output is measured; limits alone are no target")
        # An uncertainty that is not known is infinite or NaN.
        if (self.uncertainty <= 0.0).any():
            raise ValueError(f"uncertainty is {self.uncertainty}; every output's has to be positive")
        if not (np.isfinite(self.weights) & (self.weights > 0.0)).all():
            raise ValueError(f"weights are {self.weights}; every output's has to be positive")
        for one in self.samples:
            place_of(self.time, one.time)
        for limits in self._limits_beside.values():
            place_of(self.time, limits.time)

    @classmethod
    def on_grid(
        cls,
        time: FloatArray,
        y: FloatArray,
        output_names: tuple[str, ...],
        uncertainty: FloatArray,
        weights: FloatArray | None = None,
    ) -> "Measurement":
        """Take values that were measured at the output times.

        Args:
            time: Output times. Shape (t,). [s]
            y: Measured values, NaN in gaps. Shape (t, k). [per output]
            output_names: Names of the k outputs.
            uncertainty: Uncertainty of the sensors. Shape (k,). [per output]
            weights: Share of the MSE that each output has; None for the same. Shape (k,). [1]

        Raises:
            ValueError: If the shapes do not fit, or an output has no value at all.
        """
        if y.shape != (len(time), len(output_names)):
            raise ValueError(f"y {y.shape} does not fit; expected {(len(time), len(output_names))}")
        known = ~np.isnan(y)
        samples = tuple(Samples(time[known[:, k]], y[known[:, k], k]) for k in range(y.shape[1]))
        return cls(
            time, samples, output_names, uncertainty, np.ones(y.shape[1]) if weights is None else weights
        )

    @cached_property
    def y(self) -> FloatArray:
        """Measured values at the output times, NaN where no sample was taken. Shape (t, k). [per output]."""
        y = np.full((len(self.time), len(self.samples)), np.nan)
        for k, (one, place) in enumerate(zip(self.samples, self._places, strict=True)):
            on = (place.share == 0.0) | (place.share == 1.0)
            y[place.before[on] + place.share[on].astype(np.int64), k] = one.values[on]
        return y

    @cached_property
    def _places(self) -> tuple[Place, ...]:
        return tuple(place_of(self.time, one.time) for one in self.samples)

    @property
    def from_first_sample(self) -> "Measurement":
        """The same, without the output times that lie before the first sample."""
        times = [one.time for one in self.samples] + [one.time for one in self.limits if one is not None]
        first_s = min(float(one[0]) for one in times)
        first = int(np.searchsorted(self.time, first_s, side="right")) - 1
        return replace(self, time=self.time[max(first, 0) :])

    @property
    def error_lasts_s(self) -> FloatArray:
        """How long an error of each output lasts, 0 where that is not known. Shape (k,). [s]."""
        return np.zeros(len(self.samples)) if self.lasts_s is None else self.lasts_s

    @property
    def error_name(self) -> str:
        """What the error is: "MSE", with a robust loss "mean loss", correlated "whitened MSE"."""
        plain = "MSE" if self.correlation_s is None else "whitened MSE"
        return "mean loss" if any(self.losses) else plain

    @property
    def n_samples(self) -> int:
        """Number of residuals that a comparison has, those of limits included."""
        return len(self._by_target)

    @cached_property
    def measured(self) -> tuple[int, ...]:
        """Positions of the outputs that are measured: all but those that have limits alone."""
        return tuple(
            k
            for k in range(len(self.samples))
            if (limits := self.limits_of(k)) is None or not limits.is_alone
        )

    @property
    def n_measured(self) -> int:
        """Number of measured values."""
        return sum(len(self.samples[k].time) for k in self.measured)

    @cached_property
    def scales(self) -> FloatArray:
        """What a difference of each output is multiplied with to be a residual. Shape (k,).

        Its root mean square over all residuals is then the root of the MSE.
        """
        uncertainty = self.uncertainty
        n = np.array([len(one.time) for one in self.samples], dtype=np.float64)
        sum_of_weights = float(self.weights[list(self.measured)].sum())
        shares = np.sqrt(self.weights * float(self.n_samples) / (sum_of_weights * n))
        return np.asarray(uncertainty[0] / uncertainty * shares)

    @property
    def error_scales(self) -> FloatArray:
        """What makes absolute errors of the outputs comparable with the first one's. Shape (k,).

        By uncertainty and weight alone, for errors on the output grid; 1 for a single output.
        """
        share = self.weights / np.mean(self.weights)
        return self.uncertainty[0] / self.uncertainty * share

    def differences(self, y: FloatArray, output: int) -> FloatArray:
        """Return simulated minus measured at the samples of one output.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]
            output: Position of the output.

        Returns:
            Of an output with limits alone, how far it lies beyond them. Shape (n, m_k). [output's unit]
        """
        simulated, limits = self._places[output].of(y[:, :, output]), self.limits_of(output)
        if limits is not None and limits.is_alone:
            return limits.excess(simulated)
        return simulated - self.samples[output].values

    def limits_of(self, output: int) -> Limits | None:
        """Return the limits of an output, None for none."""
        return self.limits[output] if self.limits else None

    def excess(self, y: FloatArray, output: int) -> FloatArray:
        """Return how far an output lies beyond its limits at their times. Shape (n, m). [output's unit].

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]
            output: Position of the output.
        """
        limits = self.limits_of(output)
        assert limits is not None, "asked of an output with limits"
        return limits.excess(place_of(self.time, limits.time).of(y[:, :, output]))

    def loss_of(self, output: int) -> RobustLoss | None:
        """Return the robust loss of an output, None for squares."""
        return self.losses[output] if self.losses else None

    def residuals(self, y: FloatArray, output: int) -> FloatArray:
        """Return the residuals of one output's differences: whitened, as its loss counts them, scaled.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]
            output: Position of the output.

        Returns:
            Shape (n, m_k). [first output's unit]
        """
        differences, loss = self._independent(y, output), self.loss_of(output)
        return np.asarray((differences if loss is None else loss.shrunk(differences)) * self.scales[output])

    def _independent(self, y: FloatArray, output: int) -> FloatArray:
        """Return the differences of an output, whitened where its errors are correlated. Shape (n, m_k)."""
        differences, rho = self.differences(y, output), self._correlations[output]
        return differences if rho is None else whitened(differences, rho)

    @cached_property
    def _correlations(self) -> tuple[FloatArray | None, ...]:
        lasts_s = np.zeros(len(self.samples)) if self.correlation_s is None else self.correlation_s
        return tuple(
            correlations(one.time, float(tau)) if tau > 0.0 else None
            for one, tau in zip(self.samples, lasts_s, strict=True)
        )

    def scatter(self, y: FloatArray, output: int) -> FloatArray:
        """Return what the residuals of one output show of noise: those of squares, or as far as they count.

        Args:
            y: A good simulation. Shape (t, k). [per output]
            output: Position of the output.

        Returns:
            Shape (m_k,). [first output's unit]
        """
        differences, loss = self._independent(y[None], output)[0], self.loss_of(output)
        return np.asarray((differences if loss is None else loss.scatter(differences)) * self.scales[output])

    def scaled_differences(self, residuals: FloatArray) -> FloatArray:
        """Return what residuals would be without robust losses and correlation times; of limits, as they are.

        Args:
            residuals: As `compared` returns them. Shape (..., n_samples). [first output's unit]

        Returns:
            Shape as they have. [first output's unit]
        """
        if not any(self.losses) and self.correlation_s is None:
            return residuals
        plain, target_of = residuals.copy(), self._by_target[self._order]
        for k, rho in enumerate(self._correlations):
            loss, of, scale = self.loss_of(k), target_of == k, self.scales[k]
            if loss is not None:
                plain[..., of] = scale * loss.grown(residuals[..., of] / scale)
            elif rho is not None:
                plain[..., of] = coloured(residuals[..., of], rho)
        return plain

    def compared(self, y: FloatArray) -> FloatArray:
        """Return the residuals, simulated minus measured, in the order of time.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]

        Returns:
            Scaled differences, as the losses count them; the mean of their squares is the MSE or the mean
            loss. Shape (n, n_samples). [first output's unit]
        """
        parts = [self.residuals(y, k) for k in range(len(self.samples))]
        parts += [self._beyond(y, k) for k in self._limits_beside]
        joined = parts[0] if len(parts) == 1 else np.take(np.concatenate(parts, axis=1), self._order, axis=1)
        # The sum of a row must not depend on the other rows, not in its last digit.
        return np.ascontiguousarray(joined)

    def _beyond(self, y: FloatArray, output: int) -> FloatArray:
        """Return the residuals of limits beside a measurement. Shape (n, m). [first output's unit]."""
        excess, loss = self.excess(y, output), self.loss_of(output)
        # Its mean square counts like that of the differences, however many output times there are.
        scale = self.scales[output] * np.sqrt(len(self.samples[output].time) / excess.shape[1])
        return np.asarray((excess if loss is None else loss.shrunk(excess)) * scale)

    def mse(self, y: FloatArray) -> FloatArray:
        """Return the mean squared error or mean loss of every row, infinite where it is not finite.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]

        Returns:
            Shape (n,). [first output's unit squared]
        """
        residuals = self.compared(y)
        good = np.isfinite(residuals).all(axis=1)
        mse = np.full(len(y), np.inf)
        mse[good] = np.mean(residuals[good] ** 2, axis=1)
        return mse

    @property
    def output_of(self) -> IntArray:
        """Output that each residual is of, those of limits as well. Shape (n_samples,)."""
        targets = np.array([*range(len(self.samples)), *self._limits_beside], dtype=np.int64)
        return targets[self._by_target[self._order]]

    @property
    def is_of_limits(self) -> BoolArray:
        """Which residuals are of limits, not of a measurement. Shape (n_samples,)."""
        # Targets after the outputs are limits beside a measurement.
        return ~np.isin(self._by_target[self._order], self.measured)

    @cached_property
    def _limits_beside(self) -> dict[int, Limits]:
        """Positions of the outputs that have limits beside a measurement."""
        return {k: limits for k in self.measured if (limits := self.limits_of(k)) is not None}

    @cached_property
    def _times(self) -> list[FloatArray]:
        """Times of the residuals: of each output's samples, then of the limits beside them. [s]."""
        return [one.time for one in (*self.samples, *self._limits_beside.values())]

    @cached_property
    def _order(self) -> IntArray:
        """Order of the residuals: by time, then by output."""
        return np.lexsort((self._by_target, np.concatenate(self._times)))

    @cached_property
    def _by_target(self) -> IntArray:
        """Place of each residual's times among `_times`, one after the other."""
        return np.repeat(np.arange(len(self._times)), [len(time) for time in self._times])

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content, in hexadecimal."""
        arrays = [self.time, self.y, self.uncertainty]
        if np.any(self.weights != 1.0):
            arrays.append(self.weights)
        # Samples on the output times are in y.
        if any((place.share % 1.0).any() for place in self._places):
            arrays += [array for one in self.samples for array in (one.time, one.values)]
        named = repr((self.output_names, self.y.shape)) + (repr(self.losses) if any(self.losses) else "")
        if self.correlation_s is not None or any(self.limits):
            named += repr((None if self.correlation_s is None else self.correlation_s.tolist(), self.limits))
        return digest_of(named, *arrays)
