"""Arenas: what is finished is there for others, and after the death of everybody, exactly once."""

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from simulation.errors import MachineError
from simulation.toy import ToyRC
from simulation.workers.arena import Arena, Grid, RowState, recover_arenas

ROOT = Path(__file__).parents[2]
GRID = Grid(("R", "C"), ("T",), ToyRC().time)


def _half_done(spool: Path | None, n: int = 10) -> tuple[Arena, np.ndarray]:
    """Return an arena in which the even rows are good, row 1 failed and row 3 is running."""
    rows = ToyRC().parameter_space.from_unit(np.random.default_rng(0).random((n, 2)))
    arena = Arena.create(GRID, n + 5, spool=spool)
    arena.load(rows)
    arena.y[:n] = ToyRC().simulate(rows).y
    arena.states[:n:2] = RowState.GOOD
    arena.fail(1, "it would not")
    arena.states[3] = RowState.RUNNING
    return arena, rows


@pytest.fixture(params=["memory", "file"])
def arena(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Arena]:
    arena, _ = _half_done(tmp_path if request.param == "file" else None)
    yield arena
    arena.remove()
    assert not list(tmp_path.iterdir())


def test_another_process_sees_and_changes_the_same_rows(arena: Arena):
    other = Arena.attach(arena.address)
    assert other.grid.parameter_names == ("R", "C")
    assert np.array_equal(other.grid.time, arena.grid.time)
    other.y[4] = 5.0
    other.fail(5, "no\0body")
    assert (arena.y[4] == 5.0).all()
    assert arena.reason(5) == "no body"
    assert np.isnan(arena.y[5]).all()
    other.release()


def test_a_long_reason_is_cut_between_two_letters(arena: Arena):
    arena.fail(0, "é" * 2000)
    assert arena.reason(0) == "é" * 511


def test_new_rows_leave_nothing_of_the_old(arena: Arena):
    arena.load(np.full((3, 2), 2.0))
    assert arena.n == 3
    assert arena.finished().n == 0


def test_arrays_outlive_their_arena():
    arena, rows = _half_done(None)
    arena.load(rows)
    arena.y[:10] = ToyRC().simulate(rows).y
    arena.states[:10] = RowState.GOOD
    answer = arena.trajectories()
    arena.remove()
    del arena
    assert answer.digest == ToyRC().simulate(rows).digest


def test_finished_rows_are_recovered_once_their_owner_is_gone(tmp_path: Path):
    arena, rows = _half_done(tmp_path)
    assert not list(recover_arenas(tmp_path)), "the owner lives"
    arena.release()
    (found,) = recover_arenas(tmp_path)
    assert np.array_equal(found.theta, rows[[0, 1, 2, 4, 6, 8]])
    assert found.failures == ("", "it would not", "", "", "", "")
    expected = ToyRC().simulate(rows[[0, 2, 4, 6, 8]])
    assert found.take([0, 2, 3, 4, 5]).digest == expected.digest
    assert not list(tmp_path.iterdir())
    assert not list(recover_arenas(tmp_path))


def test_an_arena_stays_until_its_rows_are_stored(tmp_path: Path):
    _half_done(tmp_path)[0].release()
    recovered = recover_arenas(tmp_path)
    assert next(recovered).n == 6
    assert list(tmp_path.iterdir()), "nobody has asked for more: they may not be stored"
    assert not list(recover_arenas(tmp_path)), "and it is nobody else's"
    recovered.close()
    assert len(list(recover_arenas(tmp_path))) == 1


def test_a_forgotten_arena_can_be_recovered_and_keeps_no_file_open(tmp_path: Path):
    n_open = psutil.Process().num_fds()
    for _ in range(3):
        _half_done(tmp_path)
    assert psutil.Process().num_fds() == n_open
    assert [found.n for found in recover_arenas(tmp_path)] == [6, 6, 6]
    assert not list(tmp_path.iterdir())


def test_what_is_stored_already_is_not_recovered(tmp_path: Path):
    arena, _ = _half_done(tmp_path)
    arena.clear()
    arena.release()
    assert not list(recover_arenas(tmp_path))
    assert not list(tmp_path.iterdir())


def test_what_is_no_arena_any_more_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for n_bytes in (0, 100, 1000):
        arena, _ = _half_done(tmp_path)
        assert arena.path is not None
        os.truncate(arena.path, n_bytes)
        arena.release()
    monkeypatch.setattr("simulation.workers.arena.boot_id", lambda: b"before the power went")
    _half_done(tmp_path)[0].release()
    monkeypatch.undo()
    assert not list(recover_arenas(tmp_path))
    assert not list(tmp_path.iterdir())


def test_a_missing_spool_is_empty(tmp_path: Path):
    assert not list(recover_arenas(tmp_path / "nowhere"))


FULL = """
import resource, sys
import numpy as np
from pathlib import Path
from simulation.workers.arena import Arena, Grid
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
try:
    Arena.create(Grid(("R",), ("T",), np.arange(1000.0)), 1000, spool=Path(sys.argv[1]))
except ValueError as error:
    print(error)
"""


def test_a_full_disk_is_said_before_it_costs_a_simulation(tmp_path: Path):
    assert resource.RLIMIT_FSIZE is not None
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.stdout == f"{tmp_path}: no room for 9 MB of simulated rows (File too large); free some\n"
    assert not list(tmp_path.iterdir())


def test_a_spool_that_cannot_be_made_is_one_line(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(
        MachineError, match=r"file/spool: no room for 4 kB of simulated rows \(Not a directory\)"
    ):
        Arena.create(GRID, 1, spool=tmp_path / "file" / "spool")
