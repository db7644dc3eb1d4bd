"""Files of strangers in the place of ours: refused by kind and size before they are read, in bounded time."""

import os
import socket
import time
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from simulation import InputError
from simulation.case_reading import read_experiments
from simulation.fmi.description import read_description
from simulation.foreign_file import (
    CASE,
    LIMITS_VARIABLE,
    check_members,
    parse_toml,
    read_limited,
)
from simulation.recording import read_recording
from studies.profile import load_profile

SOON_S, SMALL_MB = 5.0, 200.0
READERS: dict[str, Callable[[Path], object]] = {
    "case": read_experiments,
    "profile": lambda path: load_profile(str(path)),
    "recording": lambda path: read_recording(path, ["a"]),
    "FMU": read_description,
}


def pipe(path: Path) -> None:
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.mkdir()


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def link_to_itself(path: Path) -> None:
    path.symlink_to(path)


def unix_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        here = Path.cwd()
        os.chdir(path.parent)  # a socket's path is short
        one.bind(path.name)
        os.chdir(here)


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(3_000_000_000)


@pytest.fixture(autouse=True)
def quick_and_small() -> Iterator[None]:
    tracemalloc.start()
    began = time.monotonic()
    yield
    peak_mb = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    assert time.monotonic() - began < SOON_S
    assert peak_mb < SMALL_MB


@pytest.mark.parametrize("make", [pipe, folder, device, link_to_itself, unix_socket, huge])
@pytest.mark.parametrize("kind", READERS)
def test_what_is_no_file_of_its_kind_is_refused_before_it_is_read(
    tmp_path: Path, kind: str, make: Callable[[Path], None]
) -> None:
    file = tmp_path / "file"
    make(file)
    with pytest.raises(InputError) as found:
        READERS[kind](file)
    assert "file" in str(found.value)
    assert "\n" not in str(found.value)
    if make is huge:
        assert f"{LIMITS_VARIABLE}=" in str(found.value)
        assert "3,000 MB" in str(found.value)


def test_a_limit_is_raised_as_the_line_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "big.toml"
    file.write_bytes(b"#" * 2_500_000)
    with pytest.raises(InputError, match=r"may have 1 MB and this one has 2\.5 MB.*STUDIES_LIMITS=3"):
        read_limited(file, CASE)
    monkeypatch.setenv(LIMITS_VARIABLE, "3")
    assert len(read_limited(file, CASE)) == 2_500_000
    for wrong in ("none", "-1", "0", "nan", "inf", "9" * 5000):
        monkeypatch.setenv(LIMITS_VARIABLE, wrong)
        with pytest.raises(InputError, match="write a number such as 4") as found:
            read_limited(file, CASE)
        assert len(str(found.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        f"a = {'[' * 3000}{']' * 3000}",
        ".".join("a" * 3000) + " = 1",
        ".".join('"a"' for _ in range(250_000)) + " = 1",
        f"a = {'9' * 5000}",
        "'''" + "a" * 900_000,
        "[" * 900_000,
    ],
    ids=lambda text: f"{text[:12]!r}",
)
def test_toml_that_takes_for_ever_is_refused_at_once(text: str) -> None:
    with pytest.raises(InputError, match=r"file\.toml: ") as found:
        parse_toml(text, "file.toml")
    assert len(str(found.value)) < 500


def bomb(file: Path, *, n_members: int = 1, size: int) -> None:
    """Write an archive of zeros: a thousandth of what it holds."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", "<a/>")
        for i in range(n_members):
            with archive.open(f"resources/{i}", "w") as member:
                for _ in range(size // 1_000_000):
                    member.write(bytes(1_000_000))


def test_an_archive_is_measured_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "bomb.fmu"
    monkeypatch.setenv(LIMITS_VARIABLE, "0.01")
    bomb(file, n_members=3, size=8_000_000)
    with pytest.raises(InputError, match=r"unpacked of an archive may have 20 MB and this one has 25 MB"):
        read_description(file)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", bytes(1_000_000))
    with pytest.raises(InputError, match=r"modelDescription.xml may have 0\.64 MB and this one has 1 MB"):
        read_description(file)
    many = [zipfile.ZipInfo(f"{i}") for i in range(1001)]
    with pytest.raises(InputError, match="an archive may have 1,000 files and this one has 1,001 files"):
        check_members(many, "file.zip")
