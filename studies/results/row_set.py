"""A set of stored rows: which parameters, in which order, of which store; the rows themselves lie there."""

import os
from dataclasses import dataclass
from pathlib import Path

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.store.joined_store import store_at
from simulation.trajectories import Trajectories
from studies.results.saved import read_arrays, write_arrays


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
        write_arrays(self.file, {"theta": self.theta, "store": store})

    @classmethod
    def load(cls, file: Path) -> "RowSet":
        """Read a set written by save().

        Raises:
            InputError: If the file is missing or damaged.
        """
        if not file.is_file():
            raise InputError(f"{file}: no such file; type: studies simulate")
        content = read_arrays(file)
        if not {"theta", "store"} <= content.keys():
            raise InputError(f"{file} is no set of simulations; remove it")
        return cls(content["theta"], file.parent / str(content["store"]), file)

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
