"""A tiny FMU with a closed form, compiled once per session, and a case around it."""

import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

REPOSITORY = Path(__file__).parents[2]

DESCRIPTION = Path(__file__).with_name("decay.xml").read_text()

CASE = Path(__file__).with_name("decay.toml").read_text()


@pytest.fixture(scope="session")
def decay_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU `decay`; parameter `mode` chooses how it fails (see decay.c)."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or fmpy.platform != "linux64":
        pytest.skip("needs a C compiler on Linux to build the FMU that fails in every way")
    folder = tmp_path_factory.mktemp("decay")
    library = folder / "decay.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    source = Path(__file__).parent / "decay.c"
    subprocess.run(
        [compiler, "-O1", "-shared", "-fPIC", f"-I{headers}", "-o", library, source, "-lm"], check=True
    )
    with zipfile.ZipFile(folder / "decay.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
        archive.write(library, "binaries/linux64/decay.so")
    return folder / "decay.fmu"


@pytest.fixture
def decay_case(decay_fmu: Path, tmp_path: Path) -> Path:
    """A folder with a case around `decay`, to be changed at will."""
    return _write_case(decay_fmu, tmp_path / "fmus" / "decay")


@pytest.fixture(scope="session")
def shared_decay_case(decay_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same folder for the whole session, not to be changed."""
    return _write_case(decay_fmu, tmp_path_factory.mktemp("shared") / "decay")


def _write_case(decay_fmu: Path, folder: Path) -> Path:
    """Write a case with half a day's window in a recording of one day at 1800 s."""
    (folder / "data").mkdir(parents=True)
    shutil.copy(decay_fmu, folder / "decay.fmu")
    (folder / "case.toml").write_text(CASE)
    time = np.arange(49) * 1800
    lines = ["time_s,T_degC,heating"]
    lines += [f"{t},{20 + np.sin(t / 1e4):.6f},{1e-3 * np.cos(t / 2e4):.9f}" for t in time]
    (folder / "data" / "recording.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="session")
def office_folder() -> Path:
    """The office's folder, once its FMU is built."""
    folder = REPOSITORY / "fmus" / "office"
    if not (folder / "Office.fmu").exists() or not (folder / "case.toml").exists():
        pytest.skip("fmus/office is not built; see fmus/office/README.md")
    return folder


@pytest.fixture(scope="session")
def office_recording() -> Path:
    """The published recording of the real office."""
    folder = REPOSITORY.parent / "shared" / "data" / "office_recording"
    if not folder.exists():
        pytest.skip("needs the published recording in ../shared/data/office_recording")
    return folder
