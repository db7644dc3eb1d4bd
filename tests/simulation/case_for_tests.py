"""Changes to the files of a case, for tests: its case file and its FMU."""

import zipfile
from collections.abc import Callable
from pathlib import Path


def edit(folder: Path, *pairs: tuple[str, str]) -> None:
    """Replace text in the case file."""
    text = (folder / "case.toml").read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    (folder / "case.toml").write_text(text)


def repack(fmu: Path, change: Callable[[dict[str, bytes]], dict[str, bytes]]) -> None:
    """Write an archive again with other members, by name."""
    with zipfile.ZipFile(fmu) as archive:
        members = change({name: archive.read(name) for name in archive.namelist()})
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
