"""Files of the working folder that are named like modules are imported by no process of a command."""

import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from project_for_tests import add_case, make_hostile, process_environment

from simulation.pool.safe_start import as_for_fmus, start_safely

LIMIT_S = 300.0


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    return make_hostile(tmp_path / "hostile")


def script(project: Path, *words: str) -> tuple[str, ...]:
    """Return a command in the form of the script that pip writes."""
    file = project / "studies"
    file.write_text(
        "import sys\nfrom studies.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
    )
    return sys.executable, str(file), *words


def test_no_worker_of_simulations_imports_from_the_working_folder(hostile: Path, project: Path) -> None:
    """test_cli_resume looks at the workers of tuning."""
    add_case(project)
    words = script(project, "simulate", "wall", "--profile", "smoke", "--jobs", "2")
    done = subprocess.run(
        words, cwd=hostile, env=process_environment(project), capture_output=True, text=True, timeout=LIMIT_S,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not (hostile / "caught").exists()


@pytest.mark.slow
def test_no_server_imports_from_the_working_folder_or_outlives_its_command(
    hostile: Path, project: Path
) -> None:
    with subprocess.Popen(
        script(project, "ui"), cwd=hostile, env=process_environment(project), stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    ) as server:  # fmt: skip
        assert server.stdout is not None
        said = []
        for line in server.stdout:
            said.append(line)
            if "http" in line or len(said) > 20:
                break
        started = psutil.Process(server.pid).children(recursive=True)
        server.kill()
    assert any("http" in line for line in said), said
    assert not (hostile / "caught").exists()
    assert started
    _, left = psutil.wait_procs(started, timeout=100.0)
    assert not left, "the server ends with the command, also where that is killed"


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
