"""An empty MLflow store, whose making takes seconds, made once for all processes that test side by side."""

import shutil
from pathlib import Path

import pytest
from made_once import made_once

factory: pytest.TempPathFactory | None = None
"""Where it is made; tests/conftest.py sets it."""


def _make(root: Path) -> None:
    from studies.tracking.quiet_mlflow import make_database

    root.mkdir()
    make_database(root / "mlflow.db")


def give_store(root: Path) -> None:
    """Give a project the store that its first study would make."""
    assert factory is not None
    made = made_once(factory, "store", _make)
    (root / "mlruns").mkdir(parents=True, exist_ok=True)
    shutil.copy(made / "mlflow.db", root / "mlruns")
