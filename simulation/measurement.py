"""What was measured, when, and how simulated outputs are compared with it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from simulation.arrays import FloatArray, IntArray, digest_of
from simulation.robust_loss import RobustLoss

# A sample this close to an output time, as a share of the output step, lies on it.
_ON_GRID = 1e-6


@dataclass(frozen=True, eq=False)
class Samples:
    """What was measured of one output: at its own times, gaps left out.

    Attributes:
        time: Sample times, rising. Shape (m,). [s]
        values: Measured values. Shape (m,). [output's unit]
    """

    time: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        if self.time.shape != self.values.shape or self.time.ndim != 1:
            raise ValueError(f"times {self.time.shape} and values {self.values.shape} do not fit")
        if not len(self.time):
            raise ValueError("an output without a sample cannot be compared")
        if not (np.isfinite(self.time).all() and np.isfinite(self.values).all()):
            raise ValueError("a sample is not finite; leave gaps out")
        if np.any(np.diff(self.time) <= 0):
            raise ValueError("sample times do not rise")


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

    Attributes:
        time: Output times. Shape (t,). [s]
        samples: What was measured of each of the k outputs, within the output times.
        output_names: Names of the outputs.
        uncertainty: Uncertainty of the sensors. Shape (k,). [per output]
        weights: Share of the MSE that each output has, relative to the others. Shape (k,). [1]
        lasts_s: How long an error of each output lasts, None where that is not known: it decides how much a
            prior weighs, and no error. Shape (k,). [s]
        losses: Robust loss of each output, None for squares; empty for squares throughout.
    """

    time: FloatArray
    samples: tuple[Samples, ...]
    output_names: tuple[str, ...]
    uncertainty: FloatArray
    weights: FloatArray
    lasts_s: FloatArray | None = None
    losses: tuple[RobustLoss | None, ...] = ()

    def __post_init__(self) -> None:
        n_outputs = len(self.output_names)
        n_losses = len(self.losses) or n_outputs
        if {len(self.samples), *self.uncertainty.shape, *self.weights.shape, n_losses} != {n_outputs}:
            raise ValueError(
                f"{len(self.samples)} series of samples, uncertainty {self.uncertainty.shape}, weights "
                f"{self.weights.shape} and {n_losses} losses do not fit {n_outputs} outputs"
            )
        # An uncertainty that is not known is infinite or NaN.
        if (self.uncertainty <= 0.0).any():
            raise ValueError(f"uncertainty is {self.uncertainty}; every output's has to be positive")
        if not (np.isfinite(self.weights) & (self.weights > 0.0)).all():
            raise ValueError(f"weights are {self.weights}; every output's has to be positive")
        for one in self.samples:
            _place(self.time, one.time)

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
    def _places(self) -> "tuple[_Place, ...]":
        return tuple(_place(self.time, one.time) for one in self.samples)

    @property
    def from_first_sample(self) -> "Measurement":
        """The same, without the output times that lie before the first sample."""
        first_s = min(float(one.time[0]) for one in self.samples)
        first = int(np.searchsorted(self.time, first_s, side="right")) - 1
        return replace(self, time=self.time[max(first, 0) :])

    @property
    def error_lasts_s(self) -> FloatArray:
        """How long an error of each output lasts, 0 where that is not known. Shape (k,). [s]."""
        return np.zeros(len(self.samples)) if self.lasts_s is None else self.lasts_s

    @property
    def error_name(self) -> str:
        """What the error is: "MSE", or "mean loss" where an output has a robust loss."""
        return "mean loss" if any(self.losses) else "MSE"

    @property
    def n_samples(self) -> int:
        """Number of residuals that a comparison has."""
        return sum(len(one.time) for one in self.samples)

    @cached_property
    def scales(self) -> FloatArray:
        """What a difference of each output is multiplied with to be a residual. Shape (k,).

        Its root mean square over all residuals is then the root of the MSE.
        """
        uncertainty = self.uncertainty
        n = np.array([len(one.time) for one in self.samples], dtype=np.float64)
        shares = np.sqrt(self.weights * n.sum() / (self.weights.sum() * n))
        return np.asarray(uncertainty[0] / uncertainty * shares)

    @property
    def error_scales(self) -> FloatArray:
        """What makes absolute errors of the outputs comparable with the first one's. Shape (k,).

        By uncertainty and weight alone, for errors on the output grid; 1 for a single output.
        """
        share = self.weights / np.mean(self.weights)
        return np.asarray(self.uncertainty[0] / self.uncertainty * share, dtype=np.float64)

    def differences(self, y: FloatArray, output: int) -> FloatArray:
        """Return simulated minus measured at the samples of one output.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]
            output: Position of the output.

        Returns:
            Shape (n, m_k). [output's unit]
        """
        place, series = self._places[output], y[:, :, output]
        if place.is_whole_grid:
            simulated = series
        else:
            simulated = series[:, place.before] * (1.0 - place.share)
            simulated += series[:, place.after] * place.share
        return simulated - self.samples[output].values

    def loss_of(self, output: int) -> RobustLoss | None:
        """Return the robust loss of an output, None for squares."""
        return self.losses[output] if self.losses else None

    def residuals(self, y: FloatArray, output: int) -> FloatArray:
        """Return the residuals of one output: differences as its loss counts them, scaled.

        Args:
            y: Simulated outputs. Shape (n, t, k). [per output]
            output: Position of the output.

        Returns:
            Shape (n, m_k). [first output's unit]
        """
        differences, loss = self.differences(y, output), self.loss_of(output)
        return np.asarray((differences if loss is None else loss.shrunk(differences)) * self.scales[output])

    def scatter(self, y: FloatArray, output: int) -> FloatArray:
        """Return what the residuals of one output show of noise: those of squares, or as far as they count.

        Args:
            y: A good simulation. Shape (t, k). [per output]
            output: Position of the output.

        Returns:
            Shape (m_k,). [first output's unit]
        """
        differences, loss = self.differences(y[None], output)[0], self.loss_of(output)
        return np.asarray((differences if loss is None else loss.scatter(differences)) * self.scales[output])

    def scaled_differences(self, residuals: FloatArray) -> FloatArray:
        """Return what residuals would be if no output had a robust loss.

        Args:
            residuals: As `compared` returns them. Shape (..., n_samples). [first output's unit]

        Returns:
            Shape as they have. [first output's unit]
        """
        if not any(self.losses):
            return residuals
        plain = residuals.copy()
        for k, loss in enumerate(self.losses):
            if loss is not None:
                of, scale = self._by_output[self._order] == k, self.scales[k]
                plain[..., of] = scale * loss.grown(residuals[..., of] / scale)
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
        residuals = self.compared(y)
        good = np.isfinite(residuals).all(axis=1)
        mse = np.full(len(y), np.inf)
        mse[good] = np.mean(residuals[good] ** 2, axis=1)
        return mse

    @cached_property
    def _order(self) -> IntArray:
        """Order of the residuals: by time, then by output."""
        times = np.concatenate([one.time for one in self.samples])
        return np.lexsort((self._by_output, times))

    @property
    def _by_output(self) -> IntArray:
        """Output of each sample, one output after the other."""
        return np.repeat(np.arange(len(self.samples)), [len(one.time) for one in self.samples])

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
        return digest_of(named, *arrays)


@dataclass(frozen=True, eq=False)
class _Place:
    """Between which output times samples lie, and how far towards the later one. Shape (m,) each."""

    before: IntArray
    after: IntArray
    share: FloatArray
    is_whole_grid: bool


def _place(grid: FloatArray, time: FloatArray) -> _Place:
    """Find samples among the output times; the share is exactly 0 or 1 on one of them."""
    before = np.clip(np.searchsorted(grid, time, side="right") - 1, 0, max(len(grid) - 2, 0))
    after = np.minimum(before + 1, len(grid) - 1)
    share = (time - grid[before]) / np.where(after > before, grid[after] - grid[before], 1.0)
    share[np.abs(share) < _ON_GRID] = 0.0
    share[np.abs(share - 1.0) < _ON_GRID] = 1.0
    outside = (share < 0.0) | (share > (after > before))
    if outside.any():
        raise ValueError(
            f"a sample at {time[outside][0]:g} s lies outside the output times, {grid[0]:g} to {grid[-1]:g} s"
        )
    at = before + share.astype(np.int64)
    is_whole_grid = not (share % 1.0).any() and np.array_equal(at, np.arange(len(grid)))
    return _Place(before, after, share, is_whole_grid)
