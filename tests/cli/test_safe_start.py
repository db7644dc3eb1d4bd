"""Files of the working folder that are named like modules are imported by no process of a command."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from mlflow_store_for_tests import give_store
from project_for_tests import REPOSITORY

from simulation.pool.safe_start import as_for_fmus, start_safely
from studies.profile import PROFILE_FOLDER

HOSTILE = ("mlflow", "multiprocessing", "numpy", "pickle", "random", "signal", "socket", "uvicorn")
LIMIT_S = 300.0


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A working folder whose modules leave their name in `caught` when they are imported."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in HOSTILE:
        trap = (
            f"import os\nos.open({str(tmp_path / 'caught')!r}, os.O_CREAT)\nraise SystemExit('{name} ran')\n"
        )
        (folder / f"{name}.py").write_text(trap)
    return folder


def command(hostile: Path, way: tuple[str, ...], *words: str) -> tuple[list[str], dict[str, str]]:
    """Return a command in a project with the wall, and its environment."""
    project = hostile.parent / "project"
    for place in ("fmus/wall", "data/wall"):
        shutil.copytree(REPOSITORY / place, project / place, dirs_exist_ok=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    environment |= {"STUDIES_ROOT": str(project), "PYTHONPATH": str(REPOSITORY)}
    if way == ("script",):  # as pip writes it
        script = project / "studies"
        script.write_text(
            "import sys\nfrom studies.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
        )
        way = (str(script),)
    return [sys.executable, *way, *words], environment


def run(hostile: Path, way: tuple[str, ...], *words: str) -> None:
    argv, environment = command(hostile, way, *words)
    done = subprocess.run(
        argv, cwd=hostile, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not (hostile.parent / "caught").exists()


def test_no_worker_of_simulations_imports_from_the_working_folder(hostile: Path) -> None:
    run(hostile, ("script",), "simulate", "wall", "--profile", "smoke", "--jobs", "2")


def test_no_worker_of_tuning_and_no_server_imports_from_the_working_folder(hostile: Path) -> None:
    give_store(hostile.parent / "project")
    smoke = (PROFILE_FOLDER / "smoke.toml").read_text(encoding="utf-8")
    profile = hostile.parent / "networks.toml"
    profile.write_text(
        smoke.replace("[tuning]\n", "[tuning]\nbaseline = false\n").replace("smoke", "networks")
    )
    short = ("--profile", str(profile), "--n-train", "16", "--trials", "1")
    run(hostile, ("-m", "studies"), "tune", "wall", *short)
    argv, environment = command(hostile, ("script",), "ui")
    with subprocess.Popen(
        argv, cwd=hostile, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as server:
        assert server.stdout is not None
        said = []
        for line in server.stdout:
            said.append(line)
            if "http" in line or len(said) > 20:
                break
        started = psutil.Process(server.pid).children(recursive=True)
        server.kill()
    assert any("http" in line for line in said), said
    assert not (hostile.parent / "caught").exists()
    assert started
    _, left = psutil.wait_procs(started, timeout=30.0)
    assert not left, "the server ends with the command, also where that is killed"


def test_the_trap_catches_who_does_not_take_care(hostile: Path) -> None:
    subprocess.run([sys.executable, "-c", "import random"], cwd=hostile, capture_output=True, check=False)
    assert (hostile.parent / "caught").exists()


def test_what_an_fmu_starts_is_as_it_would_be_without_us(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONSAFEPATH", "")  # so that what is set below is taken back
    monkeypatch.delenv("PYTHONSAFEPATH")
    start_safely()
    assert "PYTHONSAFEPATH" in os.environ
    monkeypatch.setenv("STUDIES_STORAGE", "postgresql://user:secret@host/db")
    assert not {"PYTHONSAFEPATH", "STUDIES_STORAGE"} & set(as_for_fmus(os.environ))
    monkeypatch.setenv("PYTHONSAFEPATH", "1")
    start_safely()
    assert as_for_fmus(os.environ)["PYTHONSAFEPATH"] == "1", "the user's own"
