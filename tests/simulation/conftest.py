"""A tiny FMU with a closed form, compiled once per session, and a case around it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from c_fmu_for_tests import write_fmu

CASE = Path(__file__).with_name("decay.toml").read_text()


@pytest.fixture(scope="session")
def decay_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU `decay`; parameter `mode` chooses how it fails (see decay.c)."""
    source = Path(__file__).with_name("decay.c")
    description = source.with_suffix(".xml").read_text()
    return write_fmu(tmp_path_factory.mktemp("decay") / "decay.fmu", description, source)


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
