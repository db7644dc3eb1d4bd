"""Who runs a study, on what, and from which state of the code and of the packages below it."""

import getpass
import hashlib
import platform
import subprocess
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("pelsvae-studies", "numpy", "scipy", "torch", "optuna", "mlflow", "fmpy", "numba", "SALib")
CODE: dict[str, tuple[str, ...]] = {
    "simulation": ("simulation",),
    "pelsvae": ("pelsvae",),
    "studies": (
        "studies/calibration",
        "studies/stages",
        "studies/tuning",
        "studies/physical_model.py",
        "studies/profile.py",
        "studies/sensitivity.py",
        "studies/surrogate_model.py",
    ),
}
"""Where the text lies that decides numbers: not that of commands, pages and pictures."""

_CODE = Path(__file__).resolve().parents[2]


def origin_tags(root: Path) -> dict[str, str]:
    """Describe user and git state in the tags that MLflow's pages show.

    Args:
        root: folder of the project; without git there is no commit to name.
    """
    tags = {"mlflow.source.name": "studies", "mlflow.source.type": "LOCAL"}
    try:
        tags["mlflow.user"] = getpass.getuser()
    except (KeyError, OSError):  # a container's user may have no name
        tags["mlflow.user"] = "unknown"
    commit = _git(root, "rev-parse", "HEAD")
    if commit:
        tags["mlflow.source.git.commit"] = commit
        tags["git_dirty"] = str(bool(_git(root, "status", "--porcelain", "--untracked-files=no"))).lower()
    return tags


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide numbers."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def environment(device: str = "cpu") -> dict[str, str]:
    """Return all that numbers may depend on beside what a case, a profile and a seed say.

    Args:
        device: where a network was trained, "cpu" or "cuda".
    """
    return {**_code_state(), **versions(), **_machine(), **_blas(), "device": device}


@lru_cache(maxsize=1)
def _code_state() -> dict[str, str]:
    """Return a digest of each package's text and, where it is a git checkout, its commit."""
    found = {}
    for room, places in CODE.items():
        content = hashlib.sha256()
        for file in sorted(file for place in places for file in _modules(_CODE / place)):
            content.update(f"{file.relative_to(_CODE).as_posix()}\0".encode() + file.read_bytes() + b"\0")
        found[f"code {room}"] = content.hexdigest()
    # An installed copy may lie in a folder of somebody else's repository.
    if _git(_CODE, "ls-files", str(Path(__file__).resolve())):
        found["git_commit"] = _git(_CODE, "rev-parse", "HEAD")
        changed = _git(_CODE, "diff", "HEAD", "--binary", "--no-ext-diff", "--", *CODE)
        found["git_dirty"] = str(bool(changed)).lower()
        if changed:
            found["git_diff_sha256"] = hashlib.sha256(changed.encode()).hexdigest()
    return found


def _modules(place: Path) -> list[Path]:
    return [place] if place.is_file() else list(place.rglob("*.py"))


@lru_cache(maxsize=1)
def _machine() -> dict[str, str]:
    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        model = next(
            (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model
        )
    except OSError:
        pass
    return {"platform": platform.platform(), "machine": platform.machine(), "cpu": model or "unknown"}


def _blas() -> dict[str, str]:
    """Return the library below NumPy's linear algebra, its kernel for this CPU, and its threads now."""
    import numpy as np  # noqa: F401  (loads the library)
    from threadpoolctl import threadpool_info

    for library in threadpool_info():
        if library["user_api"] == "blas" and "numpy" in library["filepath"]:
            kernel = library.get("architecture", "")
            name = f"{library['internal_api']} {library['version']} {kernel}"
            return {"blas": name.strip(), "n_threads": str(library["num_threads"])}
    return {}


def _git(root: Path, *arguments: str) -> str:
    command = ["git", *arguments]
    try:
        answer = subprocess.run(
            command, cwd=root, capture_output=True, text=True, errors="replace", timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return answer.stdout.strip()
