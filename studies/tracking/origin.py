"""Who runs a study, on what, and from which state of the code and of the packages below it."""

import getpass
import hashlib
import platform
import re
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
_REVISION = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")
_BRANCH = re.compile(r"refs/[^\x00-\x20\x7f~^:?*\\\[]+")
_MOST_BYTES = 16 * 2**20
"""Longest file of git that is read: a list of some 200,000 branches."""


def origin_tags(root: Path) -> dict[str, str]:
    """Describe user and commit in the tags that MLflow's pages show.

    Args:
        root: folder of the project; without git there is no commit to name.
    """
    tags = {"mlflow.source.name": "studies", "mlflow.source.type": "LOCAL"}
    try:
        tags["mlflow.user"] = getpass.getuser()
    except (KeyError, OSError):  # a container's user may have no name
        tags["mlflow.user"] = "unknown"
    for folder in (root, *root.parents):
        if commit := checked_out(folder):
            return tags | {"mlflow.source.git.commit": commit}
    return tags


def checked_out(folder: Path) -> str:
    """Return the commit that a git checkout is on, "" where the folder is none.

    It is read from git's files: git itself runs commands that the configuration of a checkout names, which
    may be a stranger's.

    Args:
        folder: folder that holds `.git`.
    """
    git = folder / ".git"
    if linked := _text(git):  # of a second working tree: the place of its files
        git = folder / linked.removeprefix("gitdir: ")
    shared = git / (_text(git / "commondir") or ".")
    head = _text(git / "HEAD")
    branch = head.removeprefix("ref: ")
    if branch != head:
        if not _BRANCH.fullmatch(branch) or ".." in branch:
            return ""
        packed = _text(shared / "packed-refs").splitlines()
        listed = (line.partition(" ") for line in packed)
        in_list = next((revision for revision, _, name in listed if name == branch), "")
        head = _text(git / branch) or _text(shared / branch) or in_list
    return head if _REVISION.fullmatch(head) else ""


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
    # An installed copy may lie in a folder of somebody else's repository, but not beside its .git.
    if commit := checked_out(_CODE):
        found["git_commit"] = commit
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


def _text(file: Path) -> str:
    """Return the text of a small file, "" where there is none."""
    try:
        if not file.is_file() or file.stat().st_size > _MOST_BYTES:
            return ""
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except (OSError, ValueError):  # ValueError: a name with a zero byte
        return ""
