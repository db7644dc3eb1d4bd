"""What processes that simulate and those that ask them say to each other."""

from dataclasses import dataclass

from simulation.arrays import FloatArray
from simulation.pool.execution import ExecutionPolicy


@dataclass(frozen=True)
class Job:
    """To the fork server, and through it to a new supervisor: what to simulate, and where it runs.

    Attributes:
        make_model: The model's factory, pickled.
        module: The module of the factory.
        known: What workers for this program have compiled before, see warm_code.
        policy: What happens to rows that hang, crash or fail.
        folder: Where relative paths begin.
    """

    make_model: bytes
    module: str
    known: frozenset[bytes]
    policy: ExecutionPolicy
    folder: str


@dataclass(frozen=True)
class ChunkAnswer:
    """From a supervisor: what became of the first rows of a chunk; the others are to be asked again.

    Attributes:
        y: Outputs, NaN throughout in failed rows. Shape (m, t, k). [per output]
        failures: Why each row failed; "" where it is good. Length m, at least 1.
        row_s: Time per row that did not end its process; None for no such row. [s]
    """

    y: FloatArray
    failures: tuple[str, ...]
    row_s: float | None
