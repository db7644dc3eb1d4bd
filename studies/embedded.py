"""The cases that come with the package: where they lie, and how one is copied into a project.

The wheel holds them in `studies/cases`. A checkout has them in its own `fmus` and `data`, beside the package.
"""

import os
import tomllib
from pathlib import Path

from simulation.whole_file import whole_file

_PACKAGE = Path(__file__).resolve().parent
EMBEDDED = _PACKAGE / "cases" if (_PACKAGE / "cases").is_dir() else _PACKAGE.parent
"""Folder with `fmus` and `data` of the embedded cases. Nothing is ever written there."""


def case_files(fmus: Path) -> dict[str, Path]:
    """Return the case files below a folder by their names: `<name>/case.toml`, or `*/<name>.toml`."""
    # build.toml says how an FMU is compiled.
    others = {"case.toml", "build.toml"}
    named = {file.stem: file for file in sorted(fmus.glob("*/*.toml")) if file.name not in others}
    # A link that leads nowhere counts, too: an embedded case of that name shall not take its place.
    found = [folder / "case.toml" for folder in fmus.glob("*/") if os.path.lexists(folder / "case.toml")]
    named |= {file.parent.name: file for file in found}
    return dict(sorted(named.items()))


def embedded_place(path: Path) -> str | None:
    """Return the place that an embedded file would have in a project (`fmus/wall/Wall.fmu`), else None."""
    if not path.is_relative_to(EMBEDDED):
        return None
    place = path.relative_to(EMBEDDED)
    return place.as_posix() if place.parts[:1] in (("fmus",), ("data",)) else None


def embedded_file(place: str) -> Path | None:
    """Return the embedded file that has this place, None where there is none.

    What a checkout's own runs left in its data folders belongs to that checkout and is not found here.
    """
    file = EMBEDDED / place
    is_shipped = embedded_place(file) is not None and "generated" not in Path(place).parts
    return file if is_shipped and file.is_file() else None


def adopt_cases(root: Path, data: str) -> list[Path]:
    """Copy the embedded cases that read one data folder into a project, so that they find its recordings.

    Files that the project has already stay as they are.

    Args:
        root: the project's folder.
        data: name of the folder below `data`.

    Returns:
        The case files that were written.
    """
    adopted: list[Path] = []
    for file in case_files(EMBEDDED / "fmus").values():
        declared = tomllib.loads(file.read_text(encoding="utf-8-sig"))
        if (file.parent / declared["data"]).resolve() != EMBEDDED / "data" / data:
            continue
        for source in ((file.parent / declared["fmu"]).resolve(), file):
            target = root / source.relative_to(EMBEDDED)
            if source.is_file() and not target.exists():
                with whole_file(target) as stream:
                    stream.write(source.read_bytes())
                adopted += [target] if source == file else []
    return adopted
