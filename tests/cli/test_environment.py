"""A machine that is in the way: one line with the remedy, exit code 1, no traceback."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from project_for_tests import REPOSITORY, Run


def test_a_file_in_the_place_of_a_folder_is_one_line(project: Path, studies: Run) -> None:
    shutil.rmtree(project / "mlruns", ignore_errors=True)
    (project / "mlruns").write_text("not a folder", encoding="utf-8")
    answer = studies("tune", "--profile", "smoke", "--json", "--quiet")
    assert answer.code == 1
    assert len(answer.err.splitlines()) == 1
    assert "mlruns" in answer.document["error"]
    assert "move away the file" in answer.document["error"]


def test_a_deleted_working_folder_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    done = subprocess.run(
        ["sh", "-c", 'rmdir ../gone; exec "$0" -P -m studies check wall', sys.executable],
        cwd=tmp_path / "gone",
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
    )
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "the working folder was deleted" in done.stderr


def test_no_room_is_one_line(project: Path) -> None:
    mount = ["unshare", "-m", "sh", "-c", "mount -t tmpfs none /mnt"]
    if shutil.which("unshare") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this machine allows no mounts")
    (project / "mlruns").mkdir(exist_ok=True)
    empty = "mount -t tmpfs -o size=16k none mlruns && head -c 100k /dev/zero 2> /dev/null > mlruns/rest"
    command = f'{empty}; exec "$0" -P -m studies simulate --profile smoke -q'
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", command, sys.executable],
        cwd=project,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120.0,
    )
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1), done.stderr
    assert re.search("o space left on device|is full", done.stderr)


def test_names_that_python_does_not_read_as_utf_8_are_one_line(tmp_path: Path) -> None:
    folder = tmp_path / "Prüfstand"
    folder.mkdir()
    command = [sys.executable, "-P", "-m", "studies", "status"]
    own = os.environ | {"PYTHONPATH": str(REPOSITORY), "LC_ALL": "C"}
    for utf8, code in (("0", 1), ("1", 0)):
        done = subprocess.run(
            command, cwd=folder, env=own | {"PYTHONUTF8": utf8, "PYTHONCOERCECLOCALE": "0"},
            capture_output=True, text=True, check=False, timeout=60.0,
        )  # fmt: skip
        assert (done.returncode, len(done.stderr.splitlines())) == (code, code), done.stderr
    assert not [*folder.iterdir()]


def test_linux_without_proc_is_one_line(project: Path) -> None:
    mount = ["unshare", "-m", "sh", "-c", "mount -t tmpfs none /proc"]
    if shutil.which("unshare") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this machine allows no mounts")
    done = subprocess.run(
        [*mount[:-1], f'{mount[-1]}; exec "$0" -P -m studies simulate --profile smoke -q', sys.executable],
        cwd=project,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
    )
    assert (done.returncode, len(done.stderr.splitlines())) == (1, 1), done.stderr
    assert "mount -t proc" in done.stderr
