"""Files of the working folder that are named like modules are imported by no process of a command."""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from project_for_tests import add_case, make_hostile, process_environment

from simulation.pool.safe_start import as_for_fmus, start_safely

LIMIT_S = 300.0


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    return make_hostile(tmp_path / "hostile")


def test_no_worker_of_simulations_imports_from_the_working_folder(hostile: Path, project: Path) -> None:
    """As the script that pip writes; test_cli_resume and test_browser look at tuning and at the server."""
    add_case(project)
    script = project / "studies"
    script.write_text(
        "import sys\nfrom studies.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
    )
    words = (sys.executable, str(script), "simulate", "wall", "--profile", "smoke", "--jobs", "2")
    done = subprocess.run(
        words, cwd=hostile, env=process_environment(project), capture_output=True, text=True, timeout=LIMIT_S,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not (hostile / "caught").exists()


def test_the_server_ends_with_a_command_that_is_killed(project: Path) -> None:
    words = (sys.executable, "-m", "studies", "ui")
    with subprocess.Popen(words, env=process_environment(project), stdout=subprocess.DEVNULL) as command:
        process, deadline = psutil.Process(command.pid), time.monotonic() + LIMIT_S
        while not (started := process.children(recursive=True)):
            assert time.monotonic() < deadline
            time.sleep(0.1)
        command.kill()
    _, left = psutil.wait_procs(started, timeout=30.0)
    assert not left


def test_the_trap_catches_who_does_not_take_care(hostile: Path) -> None:
    subprocess.run([sys.executable, "-c", "import random"], cwd=hostile, capture_output=True, check=False)
    assert (hostile / "caught").exists()


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
