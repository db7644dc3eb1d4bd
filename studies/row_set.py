"""A set of stored rows: which parameters, in which order, of which store; the rows themselves lie there."""

import hashlib
import os
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.store.joined_store import store_at
from simulation.trajectories import Trajectories
from simulation.whole_file import whole_file


@dataclass(frozen=True, eq=False)
class RowSet:
    """Rows of a store.

    Attributes:
        theta: Their parameters. Shape (n, p). [per parameter]
        store: The store's file.
        file: Where the set lies; messages name it.
    """

    theta: FloatArray
    store: Path
    file: Path

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.theta)

    def save(self) -> None:
        """Write the set; the store is named relative to it, so that both can be moved together."""
        store = Path(os.path.relpath(self.store, self.file.parent)).as_posix()
        with whole_file(self.file) as stream:
            np.savez(stream, allow_pickle=False, theta=self.theta, store=np.array(store))

    @classmethod
    def load(cls, file: Path) -> "RowSet":
        """Read a set written by save().

        Raises:
            InputError: If the file is missing or damaged.
        """
        try:
            with Path(file).open("rb") as stream, np.load(stream, allow_pickle=False) as content:
                return cls(content["theta"], Path(file).parent / str(content["store"]), Path(file))
        except FileNotFoundError:
            raise InputError(f"{file}: no such file; type: studies simulate") from None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(f"{file}: not a readable set of simulations ({error}); delete it") from error

    def read(self, n: int | None = None) -> Trajectories:
        """Read the rows.

        Args:
            n: How many of the first; None for all.

        Raises:
            InputError: If the store does not hold them any more.
        """
        with store_at(self.store) as store:
            try:
                return store.read(self.theta[:n])
            except LookupError as error:
                raise InputError(f"{self.file}: {error}; type: studies simulate") from None


def content_of(blocks: Iterator[Trajectories]) -> tuple[str, list[str]]:
    """Go once through rows, in bounded memory.

    Args:
        blocks: Consecutive rows; the digest does not depend on where a block ends.

    Returns:
        SHA-256 of parameters, outputs and reasons, in hexadecimal; why each row failed, "" where it is good.
    """
    theta, y = hashlib.sha256(), hashlib.sha256()
    failures: list[str] = []
    for block in blocks:
        theta.update(np.ascontiguousarray(block.theta, dtype="<f8").data)
        y.update(np.ascontiguousarray(block.y, dtype="<f8").data)
        failures.extend(block.failures)
    whole = hashlib.sha256(theta.digest() + y.digest() + repr(failures).encode())
    return whole.hexdigest(), failures
