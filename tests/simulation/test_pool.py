"""What models do to their processes costs exactly the row that did it, and all numbers stay the same."""

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from time import monotonic

import numpy as np
import psutil
import pytest
from toy_rc import ToyRC

from simulation import InputError, PoolModel
from simulation.errors import MachineError
from simulation.pool import pool_model
from simulation.pool.execution import ExecutionPolicy, TooManyFailuresError
from simulation.pool.fork_server import end_fork_servers

# Workers import the models by name, from this folder.
sys.path.insert(0, str(Path(__file__).parent))
from slow_models import (
    BAD_ABOVE_R,
    CrashingToy,
    DyingAtOpeningToy,
    ExitingToy,
    HangingToy,
    OnceCrashingToy,
    PickyToy,
    RaisingToy,
    SlowToy,
    count_begun,
    rows_of,
)

ROOT = Path(__file__).parents[2]


def test_slow_rows_get_all_workers_and_bring_the_same_bits():
    rows = rows_of(40)
    with PoolModel(SlowToy(row_s=0.05).open, 3) as model:
        answer = model.simulate(rows)
        assert model.n_processes == 3
    assert answer.digest == ToyRC().simulate(rows).digest


def test_little_work_gets_one_worker(monkeypatch: pytest.MonkeyPatch):
    # Less than a second process is worth: on a busy machine, 200 rows of nothing take longer than usual.
    for limit in ("START_PAYS_S", "_SURELY_SLOW_S"):
        monkeypatch.setattr(pool_model, limit, 120.0)
    with PoolModel(SlowToy(row_s=0.0).open, 4) as model:
        for n in (1, 15, 200):
            model.simulate(rows_of(n))
        assert model.n_processes == 1


def test_what_cannot_work_is_refused():
    with pytest.raises(ValueError, match="n_workers is 0"):
        PoolModel(ToyRC, 0)
    with pytest.raises(ValueError, match=r"theta has shape \(3, 4\); expected \(n, 2\)"):
        PoolModel(SlowToy().open).simulate(np.ones((3, 4)))
    with pytest.raises(InputError, match=r"a factory of the model, as case\.make_model, not a ToyRC"):
        PoolModel(ToyRC(), 2)
    with (
        PoolModel(lambda: ToyRC()) as model,
        pytest.raises(RuntimeError, match=r"cannot be sent to worker processes .*; give a function"),
    ):
        model.simulate(rows_of(1))


@pytest.mark.parametrize(
    ("toy", "reason"),
    [
        (ExitingToy(exit_code=0), "2 times: the FMU ended its process with exit code 0"),
        (RaisingToy(error=MemoryError), "out of memory"),
    ],
    ids=["exits with 0", "out-of-memory"],
)
def test_exactly_the_bad_rows_fail(toy: SlowToy, reason: str):
    rows = rows_of(200, 3)
    with PoolModel(toy.open, 2, policy=ExecutionPolicy(timeout_s=0.4)) as model:
        answer = model.simulate(rows)
    bad = rows[:, 0] > BAD_ABOVE_R
    assert np.array_equal(answer.failed, bad)
    assert {why for why in answer.failures if why} == {reason}
    assert answer.take(~bad).digest == ToyRC().simulate(rows[~bad]).digest


def test_a_row_that_was_unlucky_once_is_good(tmp_path: Path):
    rows = rows_of(30, 3)
    with PoolModel(OnceCrashingToy(folder=tmp_path).open, 2) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest


def test_retries_are_the_policy_s(tmp_path: Path):
    rows = rows_of(6, 2)
    for retries, toy, n_times in ((0, CrashingToy, 1), (2, CrashingToy, 3), (2, HangingToy, 1)):
        begun = tmp_path / f"{retries}-{n_times}"
        policy = ExecutionPolicy(timeout_s=0.3, retries=retries)
        with PoolModel(toy(begun=begun).open, 2, policy=policy) as model:
            model.simulate(rows)
        counts = count_begun(begun)
        bad = {row.tobytes().hex() for row in rows if row[0] > BAD_ABOVE_R}
        assert {counts[row] for row in bad} == {n_times}
        assert {n for row, n in counts.items() if row not in bad} == {1}


def test_a_batch_that_mostly_fails_stops_and_says_why(tmp_path: Path):
    rows = np.full((500, 2), [4.5, 1e4])
    rows[::3, 0] = 1.0
    begun, sizes = tmp_path / "begun", list[int]()
    with PoolModel(RaisingToy(begun=begun, row_s=0.01).open, 2) as model:
        with pytest.raises(TooManyFailuresError) as caught:
            sizes.extend(len(numbers) for numbers, _, _ in model.as_finished(rows))
        assert "more than simulation.max_failed_share = 0.5 allows" in str(caught.value)
        assert "ValueError: R is too large" in str(caught.value)
        assert "\n" not in str(caught.value)
        assert 20 <= sum(sizes) <= len(begun.read_text().split()) < 120
        # It can be asked again.
        assert not model.simulate(rows[::3]).failed.any()


def test_one_licence_means_one_worker_and_one_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # Rows share processes: new ones would have the licence by turns.
    monkeypatch.setattr("simulation.pool.pool_model._UNNOTICED_S", 0.0)
    rows, warnings = rows_of(80), []
    toy = PickyToy(licence=tmp_path / "licence")
    with PoolModel(toy.open, 3, on_warning=warnings.append) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest
    assert len(warnings) == 1
    assert warnings[0].startswith("only 1 of 3 processes go on, as no more can open the model")


@pytest.mark.parametrize(
    ("toy", "line"),
    [
        (PickyToy(), r"^picky\.fmu: there is no licence; ask for one$"),
        (DyingAtOpeningToy(), r"opening it crashed its process \(SIGABRT\)"),
    ],
)
def test_a_model_that_cannot_be_opened_is_an_error_of_the_user(toy: SlowToy, line: str):
    with PoolModel(toy.open, 2) as model, pytest.raises(InputError, match=line):
        model.simulate(rows_of(3))


def test_without_a_time_out_the_slowest_row_so_far_sets_the_limit():
    rows = rows_of(20, 1)
    rows[0, 0] = 1.0  # nothing is stopped before a row has finished
    policy = ExecutionPolicy(least_limit_s=0.3)
    with PoolModel(HangingToy().open, 2, policy=policy) as model:
        answer = model.simulate(rows)
        # The next batch remembers.
        again = model.simulate(rows[rows[:, 0] > 4.0])
    assert answer.failed.sum() == 1
    for reason in (max(answer.failures), again.failures[0]):
        assert re.match(
            r"did not answer within .* s and was stopped \(no \[simulation\] timeout_s is", reason
        )


def test_rows_that_run_when_the_time_is_over_are_ended():
    rows = rows_of(20, 1)
    with PoolModel(HangingToy().open, 2) as model:
        chunks = [numbers for numbers, *_ in model.as_finished(rows, until=monotonic() + 1.0)]
        # The bad row would never end.
        assert np.concatenate(chunks).size < 20
        assert not list(model.as_finished(rows, until=monotonic()))
        # It can be asked again.
        assert not model.simulate(rows[rows[:, 0] <= BAD_ABOVE_R]).failed.any()


def test_a_forgotten_model_leaves_no_process():
    end_fork_servers()
    before = set(psutil.Process().children(recursive=True))
    model = PoolModel(SlowToy().open, 2)
    model.simulate(rows_of(20))
    (server,) = set(psutil.Process().children()) - before
    del model
    _, alive = psutil.wait_procs(server.children(recursive=True), timeout=100)
    assert not alive
    # It waits for the next model, and is all that does.
    with PoolModel(SlowToy().open, 2) as model:
        model.simulate(rows_of(3))
        assert set(psutil.Process().children()) - before == {server}
    end_fork_servers()
    assert not set(psutil.Process().children(recursive=True)) - before


LEFT_OPEN = """
import tempfile
folder = tempfile.TemporaryDirectory()  # its finalizer is older than all of the pool's
import sys
sys.path[:0] = {places!r}
from simulation import PoolModel
from slow_models import SlowToy
model = PoolModel(SlowToy().open, 1)
assert not model.simulate(model.parameter_space.from_unit([[0.5, 0.5]])).failed.any()
"""


def test_a_script_that_closes_nothing_ends_at_once():
    places = [str(Path(__file__).parent), str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", LEFT_OPEN.format(places=places)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, "")


NO_ROOM = """
import errno, os, pathlib, tempfile
def limited(call):
    n_calls = []
    def limited_call(*arguments, **options):
        n_calls.append(call)
        if len(n_calls) > {n}:
            raise OSError(errno.{error}, os.strerror(errno.{error}))
        return call(*arguments, **options)
    return limited_call
{call} = limited({call})
"""


@pytest.mark.parametrize(
    ("call", "n", "error", "line"),
    [
        ("tempfile.mkdtemp", 0, "ENOSPC", r"no temporary folder .*No space left on device.*TMPDIR"),
        ("os.fork", 0, "EAGAIN", r"^a process .*started \(Resource temporarily unavailable\); lower"),
    ],
)
def test_where_no_process_can_be_started_the_machine_is_in_the_way(
    call: str, n: int, error: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "sitecustomize.py").write_text(NO_ROOM.format(call=call, n=n, error=error))
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    with pytest.raises(MachineError, match=line), PoolModel(ToyRC, 1) as model:
        model.simulate(rows_of(1))


def test_ctrl_c_ends_all_hands_over_what_is_finished_and_can_be_followed():
    rows, here, sizes = rows_of(400), threading.main_thread().ident, list[int]()
    assert here is not None
    with PoolModel(SlowToy(row_s=0.02).open, 2) as model:
        for wait_s in (0.05, 3.0):  # while the first process starts, and in the middle
            threading.Timer(wait_s, signal.pthread_kill, (here, signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                sizes.extend(len(numbers) for numbers, _, _ in model.as_finished(rows))
            assert model.n_processes == 0
        assert 0 < sum(sizes) < len(rows)
        assert model.simulate(rows[:5]).digest == ToyRC().simulate(rows[:5]).digest
