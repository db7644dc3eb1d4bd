"""The files a recipe names, found again by their SHA-256 wherever they lie now, and laid out as then."""

import hashlib
import os
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.recipe import Recipe, file_digest

_GIT_LIMIT_S = 30.0


def lay_out(recipe: Recipe, paths: ProjectPaths, folder: Path, *, commit: str) -> tuple[Path, list[str]]:
    """Write the case file of a recipe and put its FMU and recordings where it declares them.

    Args:
        recipe: the recipe.
        paths: the project to search.
        folder: an empty folder.
        commit: git commit that made the result, "" where none is known; its files are searched too.

    Returns:
        The case file and a line for each file that was found elsewhere than it used to be.

    Raises:
        InputError: a file of that content is nowhere.
    """
    case = folder / _case_place(recipe)
    case.parent.mkdir(parents=True, exist_ok=True)
    case.write_text(recipe["case"]["text"], encoding="utf-8")
    notes = []
    for one in recipe["files"]:
        declared = Path(one["declared"])
        content, note = _content(one, paths, commit, is_fixed=declared.is_absolute())
        notes += [note] if note else []
        if not declared.is_absolute():
            place = Path(os.path.normpath(case.parent / declared))
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
    return case, notes


def _case_place(recipe: Recipe) -> Path:
    """Return where the case file goes: its place in the project, deep enough for what it declares."""
    told = Path(recipe["case"]["place"])
    place = Path("case", told.name) if told.is_absolute() else told
    climbs = max(Path(one["declared"]).parts.count("..") for one in recipe["files"])
    return Path(*("_" * (climbs - len(place.parts) + 1)), place)


def state_of(one: Mapping[str, Any], paths: ProjectPaths) -> str:
    """Return what became of a recorded file at its place: "", or what is wrong with it."""
    place = paths.root / one["place"]
    if not place.is_file():
        return "missing"
    return "" if file_digest(place) == one["sha256"] else "changed"


def _content(
    one: Mapping[str, Any], paths: ProjectPaths, commit: str, *, is_fixed: bool
) -> tuple[bytes, str]:
    """Return a file's recorded content and, where it is not at its place, a line that says whence it is."""
    wanted, place = one["sha256"], paths.root / one["place"]
    state = state_of(one, paths)
    if not state:
        return place.read_bytes(), ""
    said = f"{one['place']} is {state}"
    if not is_fixed:
        for file in _candidates(paths, place):
            if file_digest(file) == wanted:
                return file.read_bytes(), f"{said}; {paths.show(file)} has the recorded content"
        for revision in filter(None, (commit, "HEAD")):
            content = _from_git(paths.root, revision, one["place"])
            if content is not None and hashlib.sha256(content).hexdigest() == wanted:
                return content, f"{said}; the recorded content is taken from git, {revision[:12]}"
    raise InputError(
        f"{said} and no file below fmus/ and data/ has the recorded content (sha256 "
        f"{wanted[:12]}), nor has git; copy it from where the result was made"
    )


def _candidates(paths: ProjectPaths, place: Path) -> Iterator[Path]:
    """Yield files of the same ending, those of the same name first."""
    roots = [root for root in (place.parent, paths.fmus, paths.data) if root.is_dir()]
    found = {
        file: None
        for root in dict.fromkeys(roots)
        for file in sorted(root.rglob(f"*{place.suffix}"))
        if file.is_file() and "generated" not in file.parts
    }
    return iter(sorted(found, key=lambda file: file.name != place.name))


def _from_git(root: Path, revision: str, place: str) -> bytes | None:
    command = ["git", "show", f"{revision}:./{place}"]
    try:
        return subprocess.run(command, cwd=root, capture_output=True, timeout=_GIT_LIMIT_S, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return None
