"""Temporary folders of commands go with them, and those of killed commands with the next command."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from project_for_tests import process_environment

LIMIT_S = 120.0
# A command that makes temporary folders as the stages do: itself, and in a process of multiprocessing.
BUSY = """
import multiprocessing, sys, tempfile, time
from pathlib import Path
from types import SimpleNamespace
import studies.cli

def make(prefix):
    tempfile.mkdtemp(prefix=prefix)
    time.sleep({seconds})

def run(chosen, console):
    child = multiprocessing.get_context("spawn").Process(target=make, args=("of-child-",))
    child.start()
    while not list(Path(tempfile.gettempdir()).glob("of-child-*")):
        time.sleep(0.01)
    tempfile.mkdtemp(prefix="studies-figures-")
    print("ready", flush=True)
    child.join()
    return 0

if __name__ == "__main__":
    words = SimpleNamespace(run=run, __doc__="Help.", OPTIONS=())
    studies.cli.command_module = lambda name: words
    sys.argv[1:] = ["status"]
    sys.exit(studies.cli.main())
"""


@pytest.fixture
def temporary(tmp_path: Path) -> Path:
    """The folder that TMPDIR names."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    return folder


def environment(temporary: Path) -> dict[str, str]:
    return process_environment(temporary.parent) | {"TMPDIR": str(temporary)}


def busy(temporary: Path, seconds: float) -> "subprocess.Popen[str]":
    """Start a command that makes temporary folders, and return when it has."""
    script = temporary.parent / "busy.py"
    script.write_text(BUSY.format(seconds=seconds))
    command = [sys.executable, str(script)]
    process = subprocess.Popen(
        command, env=environment(temporary), stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def next_command(temporary: Path) -> None:
    command = [sys.executable, "-m", "studies", "status"]
    done = subprocess.run(
        command, env=environment(temporary), capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stderr


def test_what_a_killed_command_leaves_goes_with_the_next(temporary: Path) -> None:
    with busy(temporary, 60.0) as process:
        (folder,) = temporary.iterdir()
        made = sorted(place.name for place in folder.iterdir())
        assert [name.rpartition("-")[0] for name in made[1:]] == ["of-child", "studies-figures"]
        next_command(temporary)
        assert sorted(place.name for place in folder.iterdir()) == made, "its owner lives"
        os.killpg(process.pid, signal.SIGKILL)
    assert list(temporary.iterdir()) == [folder]
    next_command(temporary)
    assert not list(temporary.iterdir())


def test_a_command_that_makes_nothing_needs_no_temporary_folder(temporary: Path) -> None:
    temporary.chmod(0o500)
    next_command(temporary)
