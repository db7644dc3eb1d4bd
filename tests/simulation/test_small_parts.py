"""Counting, toys, locks, whole files, scratch folders and nouns."""

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from toy_rc import ToyRC

from simulation import CountingModel
from simulation.counting import BudgetExceeded
from simulation.errors import MachineError
from simulation.file_lock import FileLock
from simulation.scratch import ScratchFolder
from simulation.whole_file import whole_file

ROWS = np.array([[1.0, 1e4], [np.nan, 1e4], [2.0, 2e4]])


def test_a_batch_beyond_the_budget_is_refused_whole_and_not_counted():
    inner = CountingModel(ToyRC())
    model = CountingModel(inner, budget=4)
    model.simulate(ROWS)
    with pytest.raises(
        BudgetExceeded, match="the next step takes 3 calls and the budget of 4 has only 1 left"
    ):
        model.simulate(ROWS)
    assert (model.n_calls, inner.n_calls) == (3, 3)
    model.simulate(ROWS[:1])
    assert model.n_calls == model.budget == 4
    with pytest.raises(BudgetExceeded, match="the budget of 4 calls is spent"):
        model.simulate(ROWS[:1])


def test_a_file_system_without_locks_is_an_error_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(MachineError, match=r"journal\.lock: this file system has no locks"):
        FileLock(tmp_path / "journal.lock").acquire()


KILLED = """
import os
from simulation.scratch import ScratchFolder
print(ScratchFolder("test-scratch-").folder, flush=True)
os.kill(os.getpid(), 9)
"""


def test_a_scratch_folder_is_never_seen_without_its_lock_and_goes_after_its_owner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    said = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, text=True, check=False).stdout
    left = Path(said.strip())
    assert left.is_dir()
    first = ScratchFolder("test-scratch-")
    assert not left.exists()
    second = ScratchFolder("test-scratch-")
    assert first.folder.is_dir()
    for scratch in (first, second):
        scratch.remove()
    assert not list(tmp_path.iterdir())


WRITING = """
import os, sys, time
from pathlib import Path
from simulation.whole_file import whole_file
with whole_file(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    print("ready", flush=True)
    time.sleep(60)
"""


def test_what_a_killed_process_had_written_goes_when_the_file_is_written_and_what_a_living_one_writes_stays(
    tmp_path: Path,
):
    path = tmp_path / "[a] table.json"
    other = tmp_path / ".another.json.0123abcd.tmp"
    other.write_bytes(b"of another program")
    command = [sys.executable, "-c", WRITING, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
        (partial,) = set(tmp_path.iterdir()) - {other}
        with whole_file(path) as file:
            file.write(b"whole")
        assert set(tmp_path.iterdir()) == {partial, path, other}
        writer.kill()
    with whole_file(path, synced=True) as file:
        file.write(b"again")
    assert set(tmp_path.iterdir()) == {path, other}
    assert path.read_bytes() == b"again"


def test_a_file_that_cannot_be_finished_leaves_the_old_one_and_nothing_beside_it(tmp_path: Path):
    path = tmp_path / "table.json"
    path.write_bytes(b"old")
    with pytest.raises(TypeError, match="bytes-like"), whole_file(path) as file:
        file.writelines([b"half", 2])  # type: ignore[list-item]
    assert [(one, one.read_bytes()) for one in tmp_path.iterdir()] == [(path, b"old")]
