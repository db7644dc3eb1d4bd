"""Unpacked FMUs: nothing outside the folder, and no folder without a living owner."""

import os
import stat
import struct
import tempfile
import zipfile
from pathlib import Path

import pytest

from simulation import InputError
from simulation.errors import MachineError
from simulation.fmi.unpack import unpacked

BINARY = "binaries/linux64/some.so"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary folder of this test's own."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


@pytest.fixture
def fmu(tmp_path: Path) -> Path:
    """An archive with what an FMU has, and with what running it does not need."""
    path = tmp_path / "some.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "<nothing/>")
        archive.writestr("binaries/linux64/some.so", "code")
        archive.writestr("binaries/x86_64-linux/some.so", "code")
        archive.writestr("binaries/win64/some.dll", "other code")
        archive.writestr("documentation/index.html", "words")
        archive.writestr("resources/table.txt", "1 2 3")
        program = zipfile.ZipInfo("resources/program")
        program.external_attr = (stat.S_IFREG | 0o755) << 16
        archive.writestr(program, "#!/bin/sh\n")
    return path


def _link(name: str) -> zipfile.ZipInfo:
    link = zipfile.ZipInfo(name)
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    return link


def test_what_running_needs_is_unpacked_and_gone_after_removal(fmu: Path, folder: Path):
    scratch = unpacked(fmu, BINARY)
    held = {str(path.relative_to(scratch.folder)) for path in scratch.folder.rglob("*") if path.is_file()}
    assert {"modelDescription.xml", "resources/table.txt", "resources/program"} <= held
    assert not any(name.startswith(("documentation", "binaries/win64")) for name in held)
    assert os.access(scratch.folder / "resources/program", os.X_OK)
    assert scratch.folder.stat().st_mode & 0o077 == 0
    scratch.remove()
    scratch.remove()
    assert not list(folder.iterdir())


@pytest.mark.parametrize("name", ["../../escaped.txt", "/escaped.txt", "..\\escaped.txt", "C:/escaped.txt"])
def test_a_member_that_points_outside_is_refused(fmu: Path, folder: Path, name: str):
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr(name, "no")
    with pytest.raises(InputError, match="points outside; do not trust this FMU"):
        unpacked(fmu, BINARY)
    assert not list(folder.iterdir())
    assert not list(folder.parent.parent.glob("**/escaped.txt"))


@pytest.mark.parametrize("name", ["resources/link", "binaries/linux64/libother.so"])
def test_a_link_is_refused_where_it_would_be_used(fmu: Path, folder: Path, name: str):
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr(_link(name), "/etc/passwd")
    with pytest.raises(InputError, match="which is a link; pack the file itself"):
        unpacked(fmu, BINARY)
    assert not list(folder.iterdir())


def _lying(content: bytes, name: str, *changes: tuple[int, int, str, int]) -> bytes:
    """Change what an archive says of a member: offsets in its central and local header, format and value."""
    said = bytearray(content)
    central = said.rindex(name.encode()) - 46  # the name follows the central header, which is the last of it
    (local,) = struct.unpack_from("<I", said, central + 42)
    for in_central, in_local, form, value in changes:
        struct.pack_into(form, said, central + in_central, value)
        struct.pack_into(form, said, local + in_local, value)
    return bytes(said)


COMPRESSION, CHECKSUM, SIZE = (10, 8, "<H"), (16, 14, "<I"), (24, 22, "<I")


@pytest.mark.parametrize(
    "change", [(*COMPRESSION, 12), (*COMPRESSION, 14), (*COMPRESSION, 99), (*CHECKSUM, 1), (*SIZE, 1)]
)
def test_a_member_that_lies_is_a_fault_of_the_archive(
    fmu: Path, folder: Path, change: tuple[int, int, str, int]
):
    fmu.write_bytes(_lying(fmu.read_bytes(), "resources/table.txt", change))
    with pytest.raises(InputError, match=r"cannot be unpacked .*; export it again") as caught:
        unpacked(fmu, BINARY)
    assert not isinstance(caught.value, MachineError)
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "names",
    [
        ("resources",),
        ("resources/table.txt/x",),
        ("resources/a/b", "resources/a"),
        ("resources/.",),
        (f"resources/{'a' * 300}",),
    ],
)
def test_names_that_no_folder_has_together_are_a_fault_of_the_archive(
    fmu: Path, folder: Path, names: tuple[str, ...]
):
    with zipfile.ZipFile(fmu, "a") as archive:
        for name in names:
            archive.writestr(name, "x")
    with pytest.raises(InputError, match=r"cannot be unpacked .*; export it again") as caught:
        unpacked(fmu, BINARY)
    assert not isinstance(caught.value, MachineError)
    assert not list(folder.iterdir())
