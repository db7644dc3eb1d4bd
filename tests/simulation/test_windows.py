"""FMUs for Windows: the same numbers through Wine, failures as rows with a reason, nothing left behind."""

import contextlib
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path
from time import monotonic

import numpy as np
import psutil
import pytest
from c_fmu_for_tests import write_fmu
from case_for_tests import edit

from simulation import InputError, PoolModel, load_case
from simulation.fmi import wine
from simulation.fmi.fmpy_description import binary_for
from simulation.fmi.variable import FmuInterface
from simulation.pool.execution import ExecutionPolicy

ROOT = Path(__file__).parents[2]
SOURCE = Path(__file__).with_name("decay.c")
STEP_ERROR, STEP_FATAL, NAN_OUTPUT, CRASH, BAD_ADDRESS = 1.0, 3.0, 4.0, 6.0, 7.0
N_KILLS = int(os.environ.get("N_KILLS", "3"))
ROW_S = 100.0  # a process that hangs fails its row, which says so
PATIENCE_S = 600.0
FEW = (0, 700, 1499)
WHICH = (wine.WORKER.name, "wineserver", "python")


@pytest.fixture(scope="module")
def windows_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("windows")
    description = SOURCE.with_suffix(".xml").read_text()
    return write_fmu(folder / "decay.fmu", description, SOURCE, "-static-libgcc", platform="win64")


@pytest.fixture
def windows_case(windows_fmu: Path, decay_case: Path, tmp_path: Path) -> Path:
    """The case of `decay` with an FMU that has a binary for Windows alone."""
    folder = tmp_path / "windows"
    shutil.copytree(decay_case, folder)
    shutil.copy(windows_fmu, folder / "decay.fmu")
    return folder


def of_wine() -> set[psutil.Process]:
    """What runs in Wine under the temporary folder of this test, as each worker has its own there."""
    found = set()
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get("WINEPREFIX", "").startswith(tempfile.gettempdir()):
                found.add(process)
    return found


def victims(kind: str) -> set[psutil.Process]:
    """The processes of a kind that this test may kill; "python" is what has started a worker in Wine."""
    found = set()
    for process in of_wine():
        with contextlib.suppress(psutil.Error):
            parent = process.parent()
            if kind == "python" and WHICH[0] in " ".join(process.cmdline()) and parent is not None:
                found.add(parent)
            elif kind in " ".join(process.cmdline()):
                found.add(process)
    return found


def test_rows_are_those_of_linux_and_failures_say_the_same(decay_case: Path, windows_case: Path):
    rows = np.array([[1e-4, 0.0], [1e-4, STEP_ERROR], [4e-4, 0.0], [4e-4, NAN_OUTPUT], [1e-4, 0.0]])
    with load_case(decay_case).open_model() as model:
        expected = model.simulate(rows)
    with load_case(windows_case).open_model() as model:
        answer = model.simulate(rows)
    assert answer.failures == expected.failures
    # Each system has an exp of its own.
    np.testing.assert_allclose(answer.y, expected.y, rtol=1e-13)
    assert np.array_equal(answer.y[0], answer.y[4])


def test_a_crash_costs_one_row_and_says_why(windows_case: Path):
    modes = np.array([0.0, BAD_ADDRESS, 0.0, STEP_FATAL, 0.0, CRASH])
    with PoolModel(load_case(windows_case).make_model, 2) as model:
        failures = model.simulate(np.column_stack([np.linspace(1e-4, 4e-4, 6), modes])).failures
    ended = "2 times: the FMU ended its process with exit code"
    assert failures == (
        "",
        f"{ended} 70; last message: exception 0xC0000005 of Windows",
        "",
        "fmi2DoStep returned fmi2Fatal at 30000 s: gave up at 30000 s",
        "",
        f"{ended} 3",
    )


@pytest.mark.slow
def test_kills_lose_no_row_and_leave_no_process(
    windows_case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Of the FMU's worker, of Wine's server, and of the process that asks them."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr(tempfile, "tempdir", None)
    edit(windows_case, ("communication_step_s = 600", "communication_step_s = 1"))
    case = load_case(windows_case)
    rows = np.column_stack([np.linspace(2e-5, 5e-4, 1500), np.zeros(1500)])
    with case.open_model() as model:
        expected = [model.simulate(rows[i : i + 1]).digest for i in FEW]
    killed, is_over = list[str](), threading.Event()

    def kill() -> None:
        while len(killed) < N_KILLS and not is_over.wait(2.0):
            wanted = WHICH[len(killed) % len(WHICH)]
            with contextlib.suppress(psutil.Error):
                for victim in victims(wanted):
                    victim.kill()
                    killed.append(wanted)
                    break

    killer = threading.Thread(target=kill, daemon=True)
    until = monotonic() + PATIENCE_S
    with PoolModel(case.make_model, 2, policy=ExecutionPolicy(timeout_s=ROW_S)) as model:
        killer.start()
        try:
            while killer.is_alive() and monotonic() < until:
                answer = model.simulate(rows)
                assert set(answer.failures) == {""}
                assert [answer.take([i]).digest for i in FEW] == expected
        finally:
            is_over.set()
    assert len(killed) == N_KILLS, killed
    assert not of_wine()
    assert not list(Path(tempfile.gettempdir()).iterdir())


@pytest.mark.parametrize(
    ("members", "installed", "line"),
    [
        (["win64/m.dll"], False, r"its binary is for Windows .*; install Wine \(Debian, Ubuntu: apt install"),
        (["win32/m.dll"], True, r"the one for Windows is a 32-bit one\); export or compile it for linux64$"),
        ([], True, r"no binary for this platform \(binaries/linux64/m\.so is missing\); export"),
    ],
)
def test_what_cannot_run_is_one_line(
    members: list[str], installed: bool, line: str, monkeypatch: pytest.MonkeyPatch
):
    program: Callable[[], Path | None] = lambda: Path("/usr/bin/wine") if installed else None  # noqa: E731
    monkeypatch.setattr("simulation.fmi.fmpy_description.wine_program", program)
    names = [f"binaries/{one}" for one in members]
    with pytest.raises(InputError, match=line):
        binary_for(Path("m.fmu"), "2.0", {"co-simulation": FmuInterface("m")}, names)
    with pytest.raises(InputError, match="is for model exchange, and Wine runs co-simulation"):
        binary_for(Path("m.fmu"), "2.0", {"model-exchange": FmuInterface("m")}, ["binaries/win64/m.dll"])


def test_a_library_that_windows_does_not_load_is_one_line(windows_case: Path, tmp_path: Path):
    broken = tmp_path / "broken.fmu"
    with zipfile.ZipFile(windows_case / "decay.fmu") as good, zipfile.ZipFile(broken, "w") as bad:
        for name in good.namelist():
            bad.writestr(name, b"no library" if name.endswith(".dll") else good.read(name))
    broken.replace(windows_case / "decay.fmu")
    with pytest.raises(InputError, match=r"decay.fmu: cannot be loaded \(error \d+ of Windows"):
        load_case(windows_case).open_model()


def test_a_folder_of_the_user_that_is_none_of_wine_is_one_line(
    windows_case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("WINEPREFIX", str(tmp_path))
    with pytest.raises(InputError, match=r"WINEPREFIX=.* has to be a folder that `wineboot` has made$"):
        load_case(windows_case).open_model()
    assert not list(tmp_path.glob("*.reg"))


def test_the_program_was_built_of_its_source():
    source = wine.WORKER.with_name("fmu_worker.c")
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    assert f"source {digest}".encode() in wine.WORKER.read_bytes(), "build it again, see CONTRIBUTING.md"
    assert wine.WORKER.stat().st_size < 300_000


def test_the_program_is_built_again_to_the_same_bytes(tmp_path: Path):
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    built = tmp_path / wine.WORKER.name
    build = ROOT / "simulation" / "worker" / "build.sh"
    subprocess.run([build, built], env=os.environ | {"PYTHON": sys.executable}, check=True)
    assert built.read_bytes() == wine.WORKER.read_bytes()
