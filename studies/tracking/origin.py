"""Who runs a study, on which machine, with which code and packages."""

import getpass
import hashlib
import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("pelsvae-studies", "numpy", "scipy", "torch", "optuna", "mlflow", "fmpy", "numba", "SALib")
_CODE = Path(__file__).resolve().parents[2]


def origin_tags() -> dict[str, str]:
    """Return who ran what, in the tags that MLflow's pages show."""
    tags = {"mlflow.source.name": "studies", "mlflow.source.type": "LOCAL"}
    with suppress(KeyError, OSError):  # a container's user may have no name
        tags["mlflow.user"] = getpass.getuser()
    return tags


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide numbers; reading one takes 10 ms."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def environment(device: str = "cpu") -> dict[str, str]:
    """Return all that numbers may depend on beside what a case, a profile and a seed say.

    Args:
        device: where a network was trained, "cpu" or "cuda".
    """
    machine = {"platform": platform.platform(), "machine": platform.machine(), "device": device}
    return {**_code_state(), **versions(), **machine, **_blas()}


@cache
def _code_state() -> dict[str, str]:
    """Return a digest of each package's text."""
    found = {}
    for room in ("simulation", "pelsvae", "studies"):
        content = hashlib.sha256()
        for file in sorted((_CODE / room).rglob("*.py")):
            content.update(f"{file.relative_to(_CODE).as_posix()}\0".encode() + file.read_bytes() + b"\0")
        found[f"code {room}"] = content.hexdigest()
    return found


def _blas() -> dict[str, str]:
    """Return the library below NumPy's linear algebra, its kernel for this CPU, and its threads now."""
    import numpy as np  # noqa: F401  (loads the library)
    from threadpoolctl import threadpool_info

    for one in threadpool_info():
        if one["user_api"] == "blas" and "numpy" in one["filepath"]:
            name = f"{one['internal_api']} {one['version']} {one.get('architecture', '')}".strip()
            return {"blas": name, "n_threads": str(one["num_threads"])}
    return {}
