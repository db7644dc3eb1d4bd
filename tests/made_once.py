"""Folders that are costly to make, made once for all processes that test side by side."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from simulation.file_lock import FileLock


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Make a folder where no other process has; return it, to be read or copied."""
    own = factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    root = shared / f"made-{name}"
    with FileLock(shared / f"made-{name}.lock"):
        if not (shared / f"made-{name}.done").is_file():
            shutil.rmtree(root, ignore_errors=True)
            make(root)
            (shared / f"made-{name}.done").touch()
    return root
