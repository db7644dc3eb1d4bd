"""FMUs made of one C file, for the tests that need models of their own."""

import shutil
import subprocess
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import fmpy
import pytest


def write_fmu(path: Path, description: str, source: Path, *flags: str, platform: str = "linux64") -> Path:
    """Compile the source and pack it; skips the test where there is no C compiler."""
    library = _library(source, *flags)
    # Without the time of day: packed again, it is the same FMU.
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(zipfile.ZipInfo("modelDescription.xml"), description)
        archive.writestr(zipfile.ZipInfo(f"binaries/{platform}/{source.stem}.so"), library)
    return path


@cache
def _library(source: Path, *flags: str) -> bytes:
    compiler = shutil.which("gcc")
    if compiler is None or fmpy.platform != "linux64":
        pytest.skip("needs gcc on Linux to build an FMU")
    headers = Path(fmpy.__file__).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "library.so"
        command = [compiler, "-O1", "-shared", "-fPIC", *flags, f"-I{headers}", "-o", library, source, "-lm"]
        subprocess.run(command, check=True)
        return library.read_bytes()
