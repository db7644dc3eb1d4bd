"""An empty MLflow store, whose making takes seconds, made once per process."""

import functools
import tempfile
from pathlib import Path


@functools.cache
def _empty_store() -> bytes:
    from studies.tracking.quiet_mlflow import make_database

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mlflow.db"
        make_database(file)
        return file.read_bytes()


def give_store(root: Path) -> None:
    """Give a project the store that its first study would make."""
    folder = root / "mlruns"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "mlflow.db").write_bytes(_empty_store())
