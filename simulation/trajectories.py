"""Simulated series with the parameters that made them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from simulation.arrays import BoolArray, FloatArray, digest_of


def wrong_number(names: Sequence[str], row: FloatArray) -> str:
    """Return which parameter is no finite number.

    Args:
        names: Names of the parameters.
        row: Their values. Shape (p,).

    Returns:
        One line, "" when all are numbers.
    """
    finite = np.isfinite(row)
    if finite.all():
        return ""
    column = int(np.argmin(finite))
    return f"parameter {names[column]} is {row[column]}"


def wrong_output(
    names: Sequence[str], times: FloatArray, y: FloatArray, *, accepted: FloatArray | None
) -> str:
    """Return the first output that is no finite number or outside its band.

    Args:
        names: Names of the outputs.
        times: Output times. Shape (t,). [s]
        y: The outputs. Shape (t, k). [declared units]
        accepted: Their bands, None for none. Shape (k, 2). [declared units]

    Returns:
        One line, "" when all are good.
    """
    wrong = ~np.isfinite(y)
    outside = np.zeros_like(wrong)
    if accepted is not None:
        outside = (y < accepted[:, 0]) | (y > accepted[:, 1])
    if not (wrong.any() or outside.any()):
        return ""
    step, column = np.argwhere(wrong | outside)[0]
    name, value, time = names[column], y[step, column], times[step]
    if wrong[step, column] or accepted is None:
        return f"output {name} is {value} at {time:g} s"
    low, high = accepted[column]
    return f"output {name} is {value:.6g} at {time:g} s, outside the accepted {low:g} to {high:g}"


@dataclass(frozen=True, eq=False)
class Trajectories:
    """What a model answered to a batch of parameters.

    Attributes:
        theta: Parameters. Shape (n, p). [per parameter]
        y: Outputs, NaN throughout in failed rows. Shape (n, t, k). [per output]
        time: Output times. Shape (t,). [s]
        parameter_names: Names of the p columns of theta.
        output_names: Names of the k outputs.
        failures: Why each row failed; "" where it is good. Length n.
    """

    theta: FloatArray
    y: FloatArray
    time: FloatArray
    parameter_names: tuple[str, ...]
    output_names: tuple[str, ...]
    failures: tuple[str, ...]

    def __post_init__(self) -> None:
        n, p = len(self.failures), len(self.parameter_names)
        expected = (n, len(self.time), len(self.output_names))
        if self.theta.shape != (n, p) or self.y.shape != expected:
            raise ValueError(
                f"theta {self.theta.shape} and y {self.y.shape} do not fit; expected {(n, p)} and {expected}"
            )

    @classmethod
    def checked(
        cls,
        theta: FloatArray,
        y: FloatArray,
        *,
        time: FloatArray,
        parameter_names: Sequence[str],
        output_names: Sequence[str],
        failures: Sequence[str] | None = None,
    ) -> "Trajectories":
        """Collect the rows of a model and make every bad one NaN throughout.

        A row is bad when a reason is given, when its parameters are not finite or when its outputs are not.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            y: Outputs; taken over without a copy where no row failed. Shape (n, t, k). [per output]
            time: Output times. Shape (t,). [s]
            parameter_names: Names of the p parameters.
            output_names: Names of the k outputs.
            failures: Reasons known already, "" for none. Length n.

        Returns:
            The trajectories, failed rows marked.
        """
        theta = np.array(theta, dtype=np.float64)
        y = np.asarray(y, dtype=np.float64)
        reasons = list(failures) if failures is not None else [""] * len(theta)
        for row in np.flatnonzero(~(np.isfinite(theta).all(axis=1) & np.isfinite(y).all(axis=(1, 2)))):
            reasons[row] = (
                reasons[row]
                or wrong_number(parameter_names, theta[row])
                or wrong_output(output_names, time, y[row], accepted=None)
            )
        failed = np.array([reason != "" for reason in reasons], dtype=np.bool_)
        if failed.any():
            y = np.where(failed[:, None, None], np.nan, y)
        time = np.asarray(time, dtype=np.float64)
        return cls(theta, y, time, tuple(parameter_names), tuple(output_names), tuple(reasons))

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.failures)

    @cached_property
    def failed(self) -> BoolArray:
        """Which rows failed. Shape (n,)."""
        return np.array([reason != "" for reason in self.failures], dtype=np.bool_)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content (names, time, parameters, outputs, reasons), in hexadecimal."""
        names = [repr(one) for one in (self.parameter_names, self.output_names, self.failures)]
        arrays = (self.time, self.theta, self.y)
        return digest_of(*names, *(part for array in arrays for part in (repr(array.shape), array)))

    def take(self, indices: npt.ArrayLike) -> "Trajectories":
        """Select rows.

        Args:
            indices: Row numbers or a boolean mask. Shape (m,) or (n,).

        Returns:
            The selected rows, in the order asked for.
        """
        chosen = np.asarray(indices)
        # An empty list comes as floats.
        rows = np.arange(self.n)[chosen if chosen.size else chosen.astype(np.intp)]
        failures = tuple(self.failures[row] for row in rows)
        return replace(self, theta=self.theta[rows], y=self.y[rows], failures=failures)

    @classmethod
    def concatenate(cls, parts: Sequence["Trajectories"]) -> "Trajectories":
        """Stack batches of the same model.

        Args:
            parts: At least one batch; all with the same names and times.

        Returns:
            All rows, in order.
        """
        return replace(
            parts[0],
            theta=np.concatenate([part.theta for part in parts]),
            y=np.concatenate([part.y for part in parts]),
            failures=tuple(reason for part in parts for reason in part.failures),
        )
