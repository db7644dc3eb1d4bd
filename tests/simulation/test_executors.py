"""Any executor gives the same bits, and a process that it loses gives its rows back."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from simulation.errors import InputError
from simulation.toy import ToyRC
from simulation.workers.execution import CampaignStopped, ExecutionPolicy
from simulation.workers.executors import ExecutorModel, dask_executor

sys.path.insert(0, str(Path(__file__).parent))
from slow_models import BAD_ABOVE_R, CrashingToy, HangingToy, PickyToy, RaisingToy, SlowToy


def _rows(n: int, n_bad: int = 0) -> np.ndarray:
    rng = np.random.default_rng(7)
    rows = ToyRC().parameter_space.from_unit(rng.random((n, 2)))
    rows[:, 0] = np.minimum(rows[:, 0], BAD_ABOVE_R)
    rows[rng.choice(n, n_bad, replace=False), 0] = 4.5
    return rows


def _spawning() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


@pytest.fixture(params=["threads", "processes"])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    before = set(psutil.Process().children(recursive=True))
    with ThreadPoolExecutor(2) if request.param == "threads" else _spawning() as executor:
        yield executor
    left = [
        process
        for process in set(psutil.Process().children(recursive=True)) - before
        if "resource_tracker" not in " ".join(process.cmdline())
    ]
    assert not psutil.wait_procs(left, timeout=5)[1]


def test_the_same_bits_and_exactly_the_bad_rows_fail(executor: Executor):
    rows = _rows(60, 4)
    policy = ExecutionPolicy(timeout_s=0.4)
    for toy in (CrashingToy(), HangingToy(row_s=0.002)):
        model = ExecutorModel(toy.open, executor, n_slots=2, policy=policy)
        answer = model.simulate(rows)
        bad = rows[:, 0] > BAD_ABOVE_R
        assert np.array_equal(answer.failed, bad)
        assert answer.take(~bad).digest == ToyRC().simulate(rows[~bad]).digest


def test_a_stream_reports_its_progress(executor: Executor, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.spooled_model.BLOCK_BYTES", 8_000)
    rows, seen = _rows(100), []
    model = ExecutorModel(ToyRC, executor, n_slots=2)
    blocks = list(model.stream(rows, on_progress=seen.append))
    assert [block.n for block in blocks] == [40, 40, 20]
    assert np.array_equal(np.concatenate([block.y for block in blocks]), ToyRC().simulate(rows).y)
    assert seen[-1] == 100


def test_errors_of_the_user_come_through(executor: Executor):
    with pytest.raises(InputError, match=r"^picky\.fmu: there is no licence; ask for one$"):
        ExecutorModel(PickyToy().open, executor).simulate(_rows(3))
    with pytest.raises(CampaignStopped, match="ValueError: R is too large"):
        ExecutorModel(RaisingToy().open, executor, n_slots=2).simulate(_rows(40, 35))


def test_a_process_that_is_killed_gives_its_rows_back():
    rows, warnings = _rows(160), []
    with closing(
        ExecutorModel(SlowToy(row_s=0.02).open, _spawning, n_slots=2, on_warning=warnings.append)
    ) as model:
        model.simulate(rows[:8])

        def kill() -> None:
            time.sleep(0.5)
            for process in psutil.Process().children():
                with suppress(psutil.ZombieProcess):
                    if "spawn_main" in " ".join(process.cmdline()):
                        os.kill(process.pid, signal.SIGKILL)
                        return

        killer = threading.Thread(target=kill)
        killer.start()
        answer = model.simulate(rows)
        killer.join()
    assert answer.digest == ToyRC().simulate(rows).digest
    assert warnings
    assert "simulated again" in warnings[0]


class BreakingExecutor(ThreadPoolExecutor):
    """Takes three pieces and is broken then, as a pool is whose process died before it is given the next."""

    n_made = n_taken = 0

    def __init__(self) -> None:
        super().__init__(2)
        type(self).n_made += 1

    def submit(self, *arguments: Any, **options: Any) -> Any:
        self.n_taken += 1
        if self.n_taken > 3:
            raise BrokenExecutor("it is broken")
        return super().submit(*arguments, **options)


def test_an_executor_that_takes_no_piece_any_more_is_replaced_where_it_can_be():
    rows, warnings = _rows(8), []
    with closing(ExecutorModel(ToyRC, BreakingExecutor, n_slots=1, on_warning=warnings.append)) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest
    assert 2 <= BreakingExecutor.n_made <= 4
    assert len(warnings) == BreakingExecutor.n_made - 1
    with pytest.raises(BrokenExecutor), BreakingExecutor() as executor:
        ExecutorModel(SlowToy().open, executor, n_slots=4).simulate(rows)


def test_an_address_without_a_scheduler_is_an_error_of_the_user(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.dask_cluster._CONNECT_S", 0.5)
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers there"):
        dask_executor("tcp://127.0.0.1:9")
