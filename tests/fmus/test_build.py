"""Building: the same sources give the same file, which compiles anywhere."""

import shutil
import subprocess
import sys
import zipfile

import pytest
from fmpy import extract, simulate_fmu
from fmpy.build import build_platform_binary
from fmu_for_tests import REPOSITORY

FOLDER = REPOSITORY / "fmus" / "office"


def contents(fmu):
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_two_builds_are_identical_bytes(compiler, tmp_path):
    first = compiler.build_fmu(FOLDER, tmp_path / "first.fmu")
    copy = shutil.copytree(FOLDER, tmp_path / "elsewhere", ignore=shutil.ignore_patterns("*.fmu"))
    assert compiler.build_fmu(copy, tmp_path / "second.fmu").read_bytes() == first.read_bytes()


@pytest.mark.parametrize("folder", ["office", "office-whitebox", "office-whitebox-metered"])
def test_the_shipped_fmu_belongs_to_its_sources(compiler, tmp_path, folder):
    model = REPOSITORY / "fmus" / folder
    (shipped,) = model.glob("*.fmu")
    built, kept = contents(compiler.build_fmu(model, tmp_path / "built.fmu")), contents(shipped)
    assert built.keys() == kept.keys()
    # Another version of gcc may well write another binary.
    different = [name for name in built if built[name] != kept[name] and not name.startswith("binaries/")]
    assert different == [], f"run: python -m fmus.compiler fmus/{folder}"


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


@pytest.mark.parametrize(
    ("folder", "names"),
    [
        ("office", ("fmi2.c", "integrate.c")),
        ("thermostat", ("fmi2_events.c", "instance.c", "events.c", "integrate.c")),
        ("wall", ("fmi3.c", "instance.c", "events.c", "integrate.c")),
    ],
)
def test_the_wrapper_compiles_without_a_warning(compiler, tmp_path, folder, names):
    (fmu,) = (REPOSITORY / "fmus" / folder).glob("*.fmu")
    extract(str(fmu), unzipdir=str(tmp_path))
    strict = [
        "gcc",
        "-std=c99",
        "-O2",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Wshadow",
        "-Wconversion",
        "-Werror",
        "-c",
    ]
    for name in names:
        command = [*strict, name, "-o", f"{name}.o"]
        result = subprocess.run(
            command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False
        )
        assert result.stderr == ""


@pytest.mark.parametrize(("folder", "output"), [("office", "TAir"), ("wall", "TMasonry")])
def test_fmpy_compiles_the_sources(compiler, tmp_path, folder, output):
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    (fmu,) = (REPOSITORY / "fmus" / folder).glob("*.fmu")
    extract(str(fmu), unzipdir=str(tmp_path / "fmu"))
    (binary,) = (tmp_path / "fmu" / "binaries").glob("*/*")
    original = binary.read_bytes()
    binary.unlink()
    (tmp_path / "cmake").mkdir()
    build_platform_binary(tmp_path / "fmu", build_dir=tmp_path / "cmake")
    assert binary.read_bytes() != original
    settings = {"stop_time": 86400.0, "output_interval": 600.0, "output": [output]}
    recompiled = simulate_fmu(str(tmp_path / "fmu"), fmi_type="CoSimulation", **settings)
    shipped = simulate_fmu(str(fmu), fmi_type="CoSimulation", **settings)
    assert abs(recompiled[output] - shipped[output]).max() < 1e-9
