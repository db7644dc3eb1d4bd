"""Building: the same sources give the same file, which compiles anywhere."""

import subprocess
import sys
import zipfile

import pytest
from fmu_for_tests import REPOSITORY

FOLDER = REPOSITORY / "fmus" / "office"


def contents(fmu):
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


FOLDERS = (
    "office",
    "office-whitebox",
    "office-whitebox-metered",
    "thermostat",
    "two-rooms",
    "vanderpol",
    "wall",
)


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_shipped_fmu_belongs_to_its_sources(compiler, tmp_path, folder):
    model = REPOSITORY / "fmus" / folder
    (shipped,) = model.glob("*.fmu")
    fmu = compiler.build_fmu(model, tmp_path / "built.fmu")
    built, kept = contents(fmu), contents(shipped)
    assert built.keys() == kept.keys()
    # Another version of gcc may well write another binary.
    different = [name for name in built if built[name] != kept[name] and not name.startswith("binaries/")]
    assert different == [], f"run: python -m fmus.compiler fmus/{folder}"
    if built == kept:
        assert fmu.read_bytes() == shipped.read_bytes()


def test_the_command_says_in_one_line_what_is_wrong(compiler, tmp_path):
    result = subprocess.run(
        [sys.executable, "-m", "fmus.compiler", str(tmp_path)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
