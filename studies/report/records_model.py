"""What is told of the model itself: what it was asked, and which of its parameters matter."""

from __future__ import annotations

from dataclasses import dataclass

from studies.report.records import Floats, require_shape


@dataclass(frozen=True)
class CoverageSet:
    """A simulated set of trajectories, to see whether it covers parameters and measurement.

    Attributes:
        name: What the set is, e.g. "training".
        theta: Shape (n, p). [parameter units]
        y: Failed rows are NaN throughout. Shape (n, t, k). [output units]
    """

    name: str
    theta: Floats
    y: Floats


@dataclass(frozen=True)
class SensitivityRecord:
    """Sobol indices for every time step; NaN where an output does not vary.

    Attributes:
        time: Shape (t,). [s]
        names: One name per parameter.
        output_names: One name per output.
        first_order: Shape (t, k, p). [1]
        total_order: Shape (t, k, p). [1]
        first_order_ci: Half width of the confidence interval. Shape (t, k, p). [1]
        total_order_ci: Half width of the confidence interval. Shape (t, k, p). [1]
        n_calls: Simulations it took, all on the model named in `model`.
        model: Which model answered: the physical model or a surrogate, in words.
    """

    time: Floats
    names: tuple[str, ...]
    output_names: tuple[str, ...]
    first_order: Floats
    total_order: Floats
    first_order_ci: Floats
    total_order_ci: Floats
    n_calls: int = 0
    model: str = ""

    def __post_init__(self) -> None:
        shape = (len(self.time), len(self.output_names), len(self.names))
        for what in ("first_order", "total_order", "first_order_ci", "total_order_ci"):
            require_shape(f"the sensitivity's {what}", getattr(self, what), shape)
