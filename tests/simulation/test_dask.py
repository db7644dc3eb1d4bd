"""A Dask cluster that sees none of our files, and loses a worker half-way: the same bits."""

import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from simulation.case import load_case
from simulation.toy import ToyRC
from simulation.workers.executors import ExecutorModel, dask_executor

sys.path.insert(0, str(Path(__file__).parent))
from slow_models import SlowToy

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=3,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as cluster:
        yield cluster


def test_a_worker_killed_half_way_costs_nothing(cluster: Any):
    rows = ToyRC().parameter_space.from_unit(np.random.default_rng(3).random((300, 2)))
    progress: list[int] = []
    with dask_executor(cluster.scheduler_address) as executor, ThreadPoolExecutor(1) as aside:
        model = ExecutorModel(SlowToy(row_s=0.03).open, executor)

        def campaign() -> list[Any]:
            return list(model.stream(rows, on_progress=progress.append))

        answer = aside.submit(campaign)
        while not progress or progress[-1] < 100:
            assert not answer.done()
            time.sleep(0.01)
        victim = cluster.workers[1]
        pid = victim.process.pid
        children = psutil.Process(pid).children(recursive=True)
        os.kill(pid, signal.SIGKILL)
        (block,) = answer.result(timeout=120)
    assert block.digest == ToyRC().simulate(rows).digest
    # What simulated for it went with it.
    assert children
    assert not psutil.wait_procs(children, timeout=5)[1]


def test_the_fmu_travels_by_its_content(cluster: Any, decay_case: Path):
    case = load_case(decay_case)
    rows = np.column_stack([np.geomspace(2e-5, 5e-4, 30), np.zeros(30)])
    with case.open_model() as here:
        expected = here.simulate(rows)
    with dask_executor(cluster.scheduler_address) as executor:
        model = ExecutorModel(case.make_model, executor)
        # The other machines have another file under this name, or none.
        hidden = case.fmu.path.with_suffix(".away")
        shutil.move(case.fmu.path, hidden)
        assert model.simulate(rows).digest == expected.digest
        assert model.simulate(rows[::-1]).digest == expected.take(np.arange(30)[::-1]).digest
