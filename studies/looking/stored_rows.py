"""Which simulations are stored already and how much room they take; nothing is written or repaired."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.folder import read_layout
from simulation.store.index import row_keys
from simulation.store.parts import Part, PartDamagedError
from studies.paths import ProjectPaths
from studies.physical_model import store_folder
from studies.profile import Profile
from studies.sensitivity import saltelli_design
from studies.stages.simulate import set_seeds


@dataclass(frozen=True)
class StoredRows:
    """The simulations of a case that are stored.

    Args:
        keys: the exact bytes of their parameters.
        bytes_per_row: room that one takes on the disk, estimated where there is none. [byte]
    """

    keys: frozenset[bytes]
    bytes_per_row: float

    def count(self, theta: FloatArray) -> int:
        """Return how many rows are stored.

        Args:
            theta: their parameters. Shape (n, p). [per parameter]
        """
        return sum(key.tobytes() in self.keys for key in row_keys(theta))


def stored_rows(paths: ProjectPaths, case: Case) -> StoredRows:
    """Look up what is stored of a case; a damaged part counts as not there."""
    folder, keys, n_bytes = store_folder(paths, case), set(), 0
    for file in _parts(folder):
        try:
            part = Part(file, read_layout(folder))
            theta, _, _ = part.keys()
            part.close()
            keys |= {key.tobytes() for key in row_keys(theta)}
            n_bytes += file.stat().st_size
        except (InputError, PartDamagedError, FileNotFoundError):
            continue
    plain = 8.0 * (case.measurement.y.size + case.parameter_space.n_parameters)
    return StoredRows(frozenset(keys), n_bytes / len(keys) if keys else plain)


def designs(case: Case, profile: Profile, *, with_sensitivity: bool) -> Mapping[str, FloatArray]:
    """Return the rows that a profile asks for, by purpose. Shapes (n, p). [per parameter]."""
    space, data, seeds = case.parameter_space, profile.data, set_seeds(profile)
    found = {
        "training": uniform_design(space, max(data.n_train), seeds["train"]),
        "validation": uniform_design(space, data.n_validation, seeds["validation"]),
        "test": uniform_design(space, data.n_test, seeds["test"]),
    }
    if with_sensitivity:
        found["sensitivity"] = saltelli_design(space, profile.sensitivity.n_base, profile.seed)
    return found


def _parts(folder: Path) -> list[Path]:
    return sorted(folder.glob("part-*.parquet")) if folder.is_dir() else []
