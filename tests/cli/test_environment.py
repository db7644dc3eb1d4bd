"""A machine that is in the way: one line with the remedy, exit code 1, no traceback."""

import errno
import os
import shutil
from pathlib import Path

import pytest
from project_for_tests import Run

from studies.environment import explain


def test_a_file_in_the_place_of_a_folder_is_one_line(project: Path, studies: Run) -> None:
    shutil.rmtree(project / "mlruns", ignore_errors=True)
    (project / "mlruns").write_text("not a folder", encoding="utf-8")
    answer = studies("tune", "--profile", "smoke", "--json", "--quiet")
    assert answer.code == 1
    assert len(answer.err.splitlines()) == 1
    assert "mlruns" in answer.document["error"]
    assert "move away the file" in answer.document["error"]


def test_a_disk_without_locks_is_no_wrong_input(
    project: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", refuse)
    answer = studies("simulate", "--profile", "smoke", "--json", "--quiet")
    assert (answer.code, len(answer.err.splitlines())) == (1, 1)
    assert "this file system has no locks" in answer.document["error"]


@pytest.mark.parametrize(
    ("error", "fragments"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "mlruns/x"), ["mlruns/x", "free some space"]),
        (OSError(errno.EACCES, "Permission denied", "mlruns/x"), ["mlruns/x", "allow"]),
        (OSError(errno.ENOSPC, "No space left on device"), ["device; free"]),
        (MemoryError("Unable to allocate 51.5 GiB"), ["51.5 GiB", "fewer samples"]),
        (MemoryError(), ["memory"]),
    ],
)
def test_what_is_in_the_way_is_named_with_its_remedy(error: Exception, fragments: list[str]) -> None:
    line = explain(error)
    assert line is not None
    assert all(fragment in line for fragment in fragments)


@pytest.mark.parametrize("error", [ValueError("ours"), OSError("without a number")])
def test_what_is_not_the_machines_fault_is_left_alone(error: Exception) -> None:
    assert explain(error) is None
