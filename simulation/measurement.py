"""What was measured, when, and how simulated outputs are compared with it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from simulation.arrays import FloatArray, IntArray, digest_of
from simulation.correlated_error import coloured, correlations, whitened
from simulation.limits import Limits
from simulation.robust_loss import RobustLoss
from simulation.samples import CountPlace, MeanPlace, Place, Samples, place_of


@dataclass(frozen=True, eq=False)
class MeasuredOutput:
    """What was measured of one output, and how its differences count.

    Attributes:
        name: Name of the output.
        unit: Unit of the measurement and of every trajectory, "" where it is left open.
        samples: What was measured. Of an output that has limits alone, its limit at their times.
        uncertainty: Uncertainty of the sensor, infinite or NaN where it is not known. [output's unit]
        weight: Share of the MSE, relative to the other outputs. [1]
        error_lasts_s: How long an error of the sensor lasts, 0 where that is not known: it decides how much a
            prior weighs, and no error. [s]
        loss: Robust loss, None for squares.
        correlation_s: Correlation time of the errors, 0 for independent ones. [s]
        limits: Limits, None for none.
    """

    name: str
    unit: str
    samples: Samples
    uncertainty: float
    weight: float = 1.0
    error_lasts_s: float = 0.0
    loss: RobustLoss | None = None
    correlation_s: float = 0.0
    limits: Limits | None = None

    @property
    def is_measured(self) -> bool:
        """Whether it has a measurement, not limits alone."""
        return self.limits is None or not self.limits.is_alone

    @cached_property
    def rho(self) -> FloatArray | None:
        """Correlation of each error with the one before, None for independent ones. Shape (m,). [1]."""
        return correlations(self.samples.time, self.correlation_s) if self.correlation_s > 0.0 else None

    def differences(self, simulated: FloatArray) -> FloatArray:
        """Return simulated minus measured, or how far simulated values lie beyond limits alone.

        Args:
            simulated: Values at the sample times. Shape (n, m). [output's unit]

        Returns:
            Shape as they have. [output's unit]
        """
        if self.limits is not None and self.limits.is_alone:
            return self.limits.excess(simulated)
        return simulated - self.samples.values

    def independent(self, simulated: FloatArray) -> FloatArray:
        """Return the differences as independent errors of the sensor's uncertainty.

        They are whitened where errors are correlated, and scaled where samples have uncertainties of their
        own. Shapes as in `differences`.
        """
        differences = self.differences(simulated)
        if self.samples.deviations is not None:
            differences = differences * (self.uncertainty / self.samples.deviations)
        return differences if self.rho is None else whitened(differences, self.rho)


@dataclass(frozen=True, eq=False)
class Measurement:
    """The target of a calibration.

    Simulated outputs are compared at the sample times, by straight lines between output times; a gap has no
    residual. With sample i of output k, its m_k samples in all, uncertainty s_k and weight w_k, the error is

        MSE = sum_k w_k / sum_k w_k * mean_i (s_1 / s_k * (simulated_ki - measured_ki))^2

    in the first output's unit squared: every output has the same say per weight, however often it was
    sampled. A sample that is a mean over an interval is compared with the mean of these lines over it, one of
    a counter with what the lines gain from its first value on.
    Where samples have uncertainties of their own, s_k is replaced by that of the sample.
    For one output, or outputs sampled alike with weights of 1, this is the mean of all squared residuals.
    For an output with a robust loss, the square of the difference is replaced by its loss: the error is then
    a mean loss.
    For an output whose errors have a correlation time, the differences are replaced by their innovations
    (see `correlated_error`), so that the sum of squares is that of the likelihood.
    An output with limits adds w_k / sum_k w_k * mean_i (s_1 / s_k * excess_ki)^2 over the output times. Where
    it has no measurement its weight is in no sum_k w_k: limits that are kept leave the error as it is.

    Attributes:
        time: Output times. Shape (t,). [s]
        outputs: What was measured of each of the k outputs, within the output times.
    """

    time: FloatArray
    outputs: tuple[MeasuredOutput, ...]

    def __post_init__(self) -> None:
        if not self.measured:
            raise ValueError("no output is measured; limits alone are no target")
        # An uncertainty that is not known is infinite or NaN.
        if (self.uncertainty <= 0.0).any():
            raise ValueError(f"uncertainty is {self.uncertainty}; every output's has to be positive")
        if not (np.isfinite(self.weights) & (self.weights > 0.0)).all():
            raise ValueError(f"weights are {self.weights}; every output's has to be positive")
        # A sample outside the output times has no place.
        _ = self._places

    @classmethod
    def on_grid(
        cls,
        time: FloatArray,
        y: FloatArray,
        output_names: tuple[str, ...],
        uncertainty: FloatArray,
    ) -> "Measurement":
        """Take values that were measured at the output times.

        Args:
            time: Output times. Shape (t,). [s]
            y: Measured values, NaN in gaps. Shape (t, k). [per output]
            output_names: Names of the k outputs, whose unit is left open.
            uncertainty: Uncertainty of the sensors. Shape (k,). [per output]

        Raises:
            ValueError: If the shapes do not fit, or an output has no value at all.
        """
        n_outputs = len(output_names)
        if y.shape != (len(time), n_outputs):
            raise ValueError(f"y {y.shape} does not fit; expected {(len(time), n_outputs)}")
        if uncertainty.shape != (n_outputs,):
            raise ValueError(f"uncertainties of shape {uncertainty.shape} do not fit {n_outputs} outputs")
        known = ~np.isnan(y)
        samples = [Samples(time[known[:, k]], y[known[:, k], k]) for k in range(n_outputs)]
        each = zip(output_names, samples, uncertainty.tolist(), strict=True)
        return cls(time, tuple(MeasuredOutput(name, "", one, sensor) for name, one, sensor in each))

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(one.name for one in self.outputs)

    @cached_property
    def uncertainty(self) -> FloatArray:
        """Uncertainty of the sensors. Shape (k,). [per output]."""
        return np.array([one.uncertainty for one in self.outputs])

    @cached_property
    def weights(self) -> FloatArray:
        """Share of the MSE that each output has, relative to the others. Shape (k,). [1]."""
        return np.array([one.weight for one in self.outputs])

    @cached_property
    def y(self) -> FloatArray:
        """Measured values at the output times, NaN where no sample was taken. Shape (t, k). [per output]."""
        y = np.full((len(self.time), len(self.outputs)), np.nan)
        for k, (one, place) in enumerate(zip(self.outputs, self._places, strict=False)):
            if not isinstance(place, Place):
                continue
            on = (place.share == 0.0) | (place.share == 1.0)
            y[place.before[on] + place.share[on].astype(np.int64), k] = one.samples.values[on]
        return y

    @cached_property
    def _targets(self) -> list[tuple[int, MeasuredOutput]]:
        """The outputs, then limits beside a measurement; each with the position of its output."""
        targets = [*enumerate(self.outputs)]
        for k, one in enumerate(self.outputs):
            if one.limits is not None and one.is_measured:
                alone = replace(one.limits, is_alone=True)
                targets.append((k, replace(one, samples=alone.samples, correlation_s=0.0, limits=alone)))
        return targets

    @cached_property
    def _places(self) -> tuple[Place | MeanPlace | CountPlace, ...]:
        """Where the samples of the targets lie among the output times."""
        return tuple(one.samples.place_on(self.time) for _, one in self._targets)

    @property
    def from_first_sample(self) -> "Measurement":
        """The same, without the output times that lie before the first sample."""
        first_s = min(one.samples.begin_s for _, one in self._targets)
        first = int(np.searchsorted(self.time, first_s, side="right")) - 1
        return replace(self, time=self.time[max(first, 0) :])

    @property
    def error_name(self) -> str:
        """What the error is: "MSE", with a robust loss "mean loss", correlated "whitened MSE"."""
        plain = "whitened MSE" if any(one.correlation_s for one in self.outputs) else "MSE"
        return "mean loss" if any(one.loss for one in self.outputs) else plain

    @property
    def n_samples(self) -> int:
        """Number of residuals that a comparison has, those of limits included."""
        return len(self._order)

    @cached_property
    def measured(self) -> tuple[int, ...]:
        """Positions of the outputs that are measured: all but those that have limits alone."""
        return tuple(k for k, one in enumerate(self.outputs) if one.is_measured)

    @cached_property
    def scales(self) -> FloatArray:
        """What a difference of each output is multiplied with to be a residual. Shape (k,).

        Its root mean square over all residuals is then the root of the MSE.
        """
        n = np.array([len(one.samples.time) for one in self.outputs])
        sum_of_weights = float(self.weights[list(self.measured)].sum())
        shares = np.sqrt(self.weights * float(self.n_samples) / (sum_of_weights * n))
        return np.asarray(self.uncertainty[0] / self.uncertainty * shares)

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
        return self.outputs[output].differences(self._places[output].of(y[:, :, output]))

    def excess(self, y: FloatArray, output: int) -> FloatArray:
        """Return how far an output lies beyond its limits at their times. Shape (n, m). [output's unit].

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]
            output: Position of the output.
        """
        limits = self.outputs[output].limits
        assert limits is not None, "asked of an output with limits"
        return limits.excess(place_of(self.time, limits.time).of(y[:, :, output]))

    def scatter(self, y: FloatArray, output: int) -> FloatArray:
        """Return what the residuals of one output show of noise: those of squares, or as far as they count.

        Args:
            y: A good simulation. Shape (t, k). [per output]
            output: Position of the output.

        Returns:
            Shape (m_k,). [first output's unit]
        """
        one = self.outputs[output]
        differences = one.independent(self._places[output].of(y[None, :, output]))[0]
        counted = differences if one.loss is None else one.loss.scatter(differences)
        return np.asarray(counted * self.scales[output])

    def scaled_differences(self, residuals: FloatArray) -> FloatArray:
        """Return what residuals would be without robust losses and correlation times; of limits, as they are.

        Args:
            residuals: As `compared` returns them. Shape (..., n_samples). [first output's unit]

        Returns:
            Shape as they have. [first output's unit]
        """
        plain = residuals.copy()
        for k, one in enumerate(self.outputs):
            of, scale = self.target_of == k, self.scales[k]
            if one.loss is not None:
                plain[..., of] = scale * one.loss.grown(residuals[..., of] / scale)
            elif one.rho is not None:
                plain[..., of] = coloured(residuals[..., of], one.rho)
        return plain

    def compared(self, y: FloatArray) -> FloatArray:
        """Return the residuals, simulated minus measured, in the order of time.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]

        Returns:
            Scaled differences, as the losses count them; the mean of their squares is the MSE or the mean
            loss. Shape (n, n_samples). [first output's unit]
        """
        parts = []
        for (k, one), place in zip(self._targets, self._places, strict=True):
            differences = one.independent(place.of(y[:, :, k]))
            counted = differences if one.loss is None else one.loss.shrunk(differences)
            # The mean square of limits counts like that of the differences, however many times they have.
            n_by_own = len(self.outputs[k].samples.time) / len(one.samples.time)
            parts.append(counted * (self.scales[k] * np.sqrt(n_by_own)))
        joined = parts[0] if len(parts) == 1 else np.take(np.concatenate(parts, axis=1), self._order, axis=1)
        # The sum of a row must not depend on the other rows, not in its last digit.
        return np.ascontiguousarray(joined)

    def mse(self, y: FloatArray) -> FloatArray:
        """Return the mean squared error or mean loss of every row, infinite where it is not finite.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]

        Returns:
            Shape (n,). [first output's unit squared]
        """
        with np.errstate(over="ignore"):  # of a simulation that diverges
            mse = np.mean(self.compared(y) ** 2, axis=1)
        return np.where(np.isfinite(mse), mse, np.inf)

    @property
    def output_of(self) -> IntArray:
        """Output that each residual is of, those of limits as well. Shape (n_samples,)."""
        return np.array([k for k, _ in self._targets])[self.target_of]

    @cached_property
    def target_of(self) -> IntArray:
        """What each residual is of: the position of its output, beyond them for limits beside a measurement.

        Shape (n_samples,).
        """
        n = [len(one.samples.time) for _, one in self._targets]
        return np.repeat(np.arange(len(n)), n)[self._order]

    @cached_property
    def _order(self) -> IntArray:
        """Order of the residuals: by time, then by target."""
        return np.argsort(np.concatenate([one.samples.time for _, one in self._targets]), kind="stable")

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content, in hexadecimal."""
        arrays = [self.time, self.y, self.uncertainty]
        if np.any(self.weights != 1.0):
            arrays.append(self.weights)
        # Samples on the output times are in y.
        its = self._places[: len(self.outputs)]
        if any(not isinstance(place, Place) or (place.share % 1.0).any() for place in its):
            arrays += [array for one in self.outputs for array in (one.samples.time, one.samples.values)]
        losses, limits = (tuple(getattr(one, key) for one in self.outputs) for key in ("loss", "limits"))
        lasts_s = [one.correlation_s for one in self.outputs]
        named = repr((self.output_names, self.y.shape)) + (repr(losses) if any(losses) else "")
        if any(lasts_s) or any(limits):
            named += repr((lasts_s if any(lasts_s) else None, limits if any(limits) else ()))
        if any(one.samples.are_means for one in self.outputs):
            named += repr([one.samples.interval for one in self.outputs])
        since_s = [one.samples.since_s for one in self.outputs]
        if any(one is not None for one in since_s):
            named += repr(since_s)
        deviations = [one.samples.deviations for one in self.outputs]
        if any(one is not None for one in deviations):
            named += repr([one is not None for one in deviations])
            arrays += [one for one in deviations if one is not None]
        return digest_of(named, *arrays)
