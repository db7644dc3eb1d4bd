"""What was measured, on the grid of the simulated outputs."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simulation.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Measurement:
    """The target of a calibration.

    Attributes:
        time: Output times. Shape (t,). [s]
        y: Measured values. Shape (t, k). [per output]
        output_names: Names of the k outputs.
        uncertainty: Uncertainty of the sensors. Shape (k,). [per output]
    """

    time: FloatArray
    y: FloatArray
    output_names: tuple[str, ...]
    uncertainty: FloatArray

    def __post_init__(self) -> None:
        expected = (len(self.time), len(self.output_names))
        if self.y.shape != expected or self.uncertainty.shape != expected[1:]:
            raise ValueError(
                f"y {self.y.shape} and uncertainty {self.uncertainty.shape} do not fit; "
                f"expected {expected} and {expected[1:]}"
            )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content, in hexadecimal."""
        content = hashlib.sha256(repr((self.output_names, self.y.shape)).encode())
        for array in (self.time, self.y, self.uncertainty):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()
