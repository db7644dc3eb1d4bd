"""FMUs made of one C file, for the tests that need models of their own."""

import shutil
import subprocess
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import fmpy
import pytest

from simulation.fmi.wine import wine_program

WINDOWS = ("win64", "x86_64-windows")
"""Folders of binaries for Windows, by FMI 2.0 and 3.0."""


def write_fmu(path: Path, description: str, source: Path, *flags: str, platform: str = "linux64") -> Path:
    """Compile the source and pack it; skips the test where there is no C compiler, or no Wine for Windows."""
    is_for_windows = platform in WINDOWS
    library = _library(source, is_for_windows, *flags)
    # Without the time of day: packed again, it is the same FMU.
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo("modelDescription.xml"), description)
        archive.writestr(
            zipfile.ZipInfo(f"binaries/{platform}/{source.stem}{'.dll' if is_for_windows else '.so'}"),
            library,
        )
    return path


@cache
def _library(source: Path, is_for_windows: bool, *flags: str) -> bytes:
    compiler = shutil.which("x86_64-w64-mingw32-gcc" if is_for_windows else "gcc")
    if compiler is None or fmpy.platform != "linux64":
        pytest.skip(f"needs gcc{' for Windows' * is_for_windows} on Linux to build an FMU")
    if is_for_windows and wine_program() is None:
        pytest.skip("Wine is not installed")
    headers = Path(fmpy.__file__).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "library.so"
        command = [
            compiler,
            "-O1",
            "-shared",
            *([] if is_for_windows else ["-fPIC"]),
            *flags,
            f"-I{headers}",
            "-o",
            library,
            source,
            "-lm",
        ]
        subprocess.run(command, check=True)
        return library.read_bytes()
