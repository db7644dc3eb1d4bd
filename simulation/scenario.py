"""Boundary conditions of a co-simulation: which input value holds over which communication step."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from simulation.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

Interpolation = Literal["held", "linear", "smooth", "spread"]
"""What a series is between its samples; "spread" are means of intervals one after the other, made smooth."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What drives a model, and when it is looked at.

    Attributes:
        time_communication: Edges of the m communication steps. Shape (m + 1,). [s]
        inputs: Input values, each constant over its step. Shape (m, n_inputs). [model's units]
        input_names: Names of the inputs.
        output_every: Communication steps between two outputs; divides m.
        n_warmup: First outputs that are simulated and not reported.
        inputs_at_edges: Input values that outputs at the edges see, None where these see their step's. Shape
            (m + 1, n_inputs). [model's units]
    """

    time_communication: FloatArray
    inputs: FloatArray
    input_names: tuple[str, ...]
    output_every: int
    n_warmup: int = 0
    inputs_at_edges: FloatArray | None = None

    @property
    def driving(self) -> tuple[FloatArray, ...]:
        """All arrays of inputs."""
        return (self.inputs,) if self.inputs_at_edges is None else (self.inputs, self.inputs_at_edges)

    @cached_property
    def time(self) -> FloatArray:
        """Times of the reported outputs; without a warm-up the first edge is one. Shape (t,). [s]."""
        return self.time_communication[self.n_warmup * self.output_every :: self.output_every].copy()


def values_at_edges(
    time: FloatArray, values: FloatArray, edges: FloatArray, *, interpolation: Interpolation
) -> FloatArray:
    """Give the value of a series at each edge of the communication steps; of a held one the step's before.

    Args:
        time: Sample times. Shape (m,). [s]
        values: Samples. Shape (m,).
        edges: Edges of the communication steps, inside what the series covers. Shape (s + 1,). [s]
        interpolation: As for `values_over_steps`.

    Returns:
        One value per edge. Shape (s + 1,).
    """
    if interpolation == "held":
        over_steps = values_over_steps(time, values, edges, interpolation=interpolation)
        return np.concatenate([over_steps[:1], over_steps])
    if interpolation == "linear":
        return np.interp(edges, time, values)
    from scipy.interpolate import PchipInterpolator

    if interpolation == "spread":
        return _sums_of_means(time, values).derivative()(edges)
    return PchipInterpolator(time, values)(np.clip(edges, time[0], time[-1]))


def covers(time: FloatArray, edges: FloatArray, interpolation: Interpolation) -> bool:
    """Return whether a series is known over all communication steps.

    A held sample, and a mean, is good for one usual (median) step beyond its time; others end with the last.

    Args:
        time: Sample times. Shape (m,). [s]
        edges: Edges of the communication steps. Shape (s + 1,). [s]
        interpolation: How the series is read between its samples.

    Returns:
        Whether no step needs a value from outside.
    """
    step = float(np.median(np.diff(time)))
    slack = 1e-9 * step
    end = time[-1] + (step if interpolation in ("held", "spread") else 0.0)
    return bool(time[0] <= edges[0] + slack and edges[-1] <= end + slack)


def values_over_steps(
    time: FloatArray, values: FloatArray, edges: FloatArray, *, interpolation: Interpolation
) -> FloatArray:
    """Give the constant that stands for a series over each communication step.

    Args:
        time: Sample times. Shape (m,). [s]
        values: Samples. Shape (m,).
        edges: Edges of the communication steps, inside what the series covers. Shape (s + 1,). [s]
        interpolation: "held": the sample last taken when the step starts; "linear": exact mean of the
            straight lines between samples; "smooth": exact mean of the monotone cubic (pchip) through them;
            "spread": the same through the sums of means, whose intervals begin at `time`; all are kept.

    Returns:
        One value per step. Shape (s,).

    Raises:
        ValueError: If the series does not cover the steps: it is never extended silently.
    """
    # Every worker process imports this module, and none needs a spline: a second of imports for each.
    from scipy.interpolate import PchipInterpolator, PPoly

    if not covers(time, edges, interpolation):
        raise ValueError(
            f"the series from {time[0]:g} to {time[-1]:g} s does not cover {edges[0]:g} to {edges[-1]:g} s"
        )
    if interpolation == "held":
        # A millionth of a sample step forgives edges whose sum of floats falls just short of a sample.
        at = np.searchsorted(time, edges[:-1] + 1e-6 * np.median(np.diff(time)), side="right") - 1
        return values[at]
    if interpolation == "spread":
        return np.diff(_sums_of_means(time, values)(edges)) / np.diff(edges)
    # Integrated relative to the start of the window and to the mean: no digits are lost in large integrals.
    start, level = edges[0], float(np.mean(values))
    if interpolation == "linear":
        slopes = np.diff(values) / np.diff(time)
        curve = PPoly(np.stack([slopes, values[:-1] - level]), time - start)
    else:
        curve = PchipInterpolator(time - start, values - level)
    integral = curve.antiderivative()(edges - start)
    return np.diff(integral) / np.diff(edges) + level


def _sums_of_means(time: FloatArray, values: FloatArray) -> "PchipInterpolator":
    """Return the integral of means from the first begin on, a monotone cubic: rates change no sign between.

    Args:
        time: Begins of the intervals. Shape (m,). [s]
        values: Means, each until the next begin. Shape (m,).
    """
    from scipy.interpolate import PchipInterpolator

    ends = np.append(time, time[-1] + np.median(np.diff(time)))
    sums = np.append(0.0, np.cumsum(values * np.diff(ends)))
    return PchipInterpolator(ends, sums)
