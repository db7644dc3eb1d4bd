"""Results as MLflow recorded them."""

from studies.paths import ProjectPaths
from studies.reproduction.recorded import Recorded


def find_run(paths: ProjectPaths, run: str) -> Recorded:
    """Find a run by the first digits of its id."""
    raise NotImplementedError
