"""What the rows of a store look like, and the checksum that each of them carries."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.errors import InputError
from simulation.trajectories import Trajectories

FAILURE, WRITTEN, CHECK = "_failure", "_written", "_check"
"""Columns beside parameters and outputs: reason, time of writing, checksum of the row."""
# Rows are read by the group: small enough for a few rows of a large store, large enough to open it soon.
GROUP_BYTES: Final = 4 * 2**20


@dataclass(frozen=True, eq=False)
class Layout:
    """What all rows of a store have in common.

    Attributes:
        model_digest: Digest of the model that answered.
        parameter_names: Names of the p parameters.
        output_names: Names of the k outputs.
        time: Output times. Shape (t,). [s]
    """

    model_digest: str
    parameter_names: tuple[str, ...]
    output_names: tuple[str, ...]
    time: FloatArray

    def __post_init__(self) -> None:
        names = [*self.parameter_columns, *self.output_names, FAILURE, WRITTEN, CHECK]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(
                f"{twice[0]!r} names two columns of the simulations; parameters and outputs need names of "
                f"their own, other than {FAILURE}, {WRITTEN} and {CHECK}"
            )

    @property
    def parameter_columns(self) -> tuple[str, ...]:
        """Columns of the parameters; an initial state may have the name of an output."""
        return tuple(
            f"_parameter_{name}" if name in self.output_names else name for name in self.parameter_names
        )

    @property
    def row_bytes(self) -> int:
        """Size of one row's outputs, at least 1. [byte]."""
        return max(1, 8 * len(self.time) * len(self.output_names))

    @property
    def rows_per_group(self) -> int:
        """Rows that are read together."""
        return max(1, GROUP_BYTES // self.row_bytes)

    def trajectories(self, theta: FloatArray, y: FloatArray, failures: Sequence[str]) -> Trajectories:
        """Return rows of this layout. Shapes (n, p) and (n, t, k)."""
        return Trajectories(theta, y, self.time, self.parameter_names, self.output_names, tuple(failures))


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows as a part holds them.

    Attributes:
        trajectories: The rows.
        written: When each was written, since 1970. Shape (n,). [µs]
    """

    trajectories: Trajectories
    written: IntArray

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.trajectories.n

    def take(self, which: BoolArray) -> "Rows":
        """Select rows by a mask. Shape (n,)."""
        return Rows(self.trajectories.take(which), self.written[which])

    @classmethod
    def joined(cls, several: Sequence["Rows"]) -> "Rows":
        """Return the rows of all."""
        return cls(
            Trajectories.concatenate([rows.trajectories for rows in several]),
            np.concatenate([rows.written for rows in several]),
        )

    def checks(self, model_digest: str) -> IntArray:
        """Return each row's CRC-32 over all that it says, and of which model. Shape (n,)."""
        model = zlib.crc32(model_digest.encode())
        theta = np.ascontiguousarray(self.trajectories.theta, dtype="<f8")
        y = np.ascontiguousarray(self.trajectories.y, dtype="<f8")
        written = np.ascontiguousarray(self.written, dtype="<i8")
        sums = np.empty(self.n, dtype=np.int64)
        for i, reason in enumerate(self.trajectories.failures):
            head = theta[i].tobytes() + written[i].tobytes() + reason.encode()
            sums[i] = zlib.crc32(y[i].reshape(-1).view(np.uint8), zlib.crc32(head, model))
        return sums
