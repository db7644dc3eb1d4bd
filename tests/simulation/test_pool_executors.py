"""Any executor gives the same bits; a cluster that sees none of our files and loses a worker, too."""

import json
import multiprocessing
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from project_for_tests import make_project
from toy_rc import ToyRC

from simulation import InputError, PoolModel, load_case
from simulation.pool.execution import ExecutionPolicy, TooManyFailuresError
from simulation.pool.fork_server import end_fork_servers
from studies.cli import main

sys.path.insert(0, str(Path(__file__).parent))
from slow_models import BAD_ABOVE_R, CrashingToy, HangingToy, PickyToy, RaisingToy, SlowToy, rows_of


def _spawning() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


@pytest.fixture(params=["threads", "processes"])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    before = set(psutil.Process().children(recursive=True))
    with ThreadPoolExecutor(2) if request.param == "threads" else _spawning() as executor:
        yield executor
    end_fork_servers()
    left = [
        process
        for process in set(psutil.Process().children(recursive=True)) - before
        if "resource_tracker" not in " ".join(process.cmdline())
    ]
    assert not psutil.wait_procs(left, timeout=100)[1]


def test_the_same_bits_and_exactly_the_bad_rows_fail(executor: Executor):
    rows = rows_of(60, 4)
    policy = ExecutionPolicy(timeout_s=0.4)
    for toy in (CrashingToy(), HangingToy(row_s=0.002)):
        model = PoolModel(toy.open, 2, executor=executor, policy=policy)
        answer = model.simulate(rows)
        bad = rows[:, 0] > BAD_ABOVE_R
        assert np.array_equal(answer.failed, bad)
        assert answer.take(~bad).digest == ToyRC().simulate(rows[~bad]).digest


def test_errors_of_the_user_come_through(executor: Executor):
    with pytest.raises(InputError, match=r"^picky\.fmu: there is no licence; ask for one$"):
        PoolModel(PickyToy().open, 2, executor=executor).simulate(rows_of(3))
    with pytest.raises(TooManyFailuresError, match="ValueError: R is too large"):
        PoolModel(RaisingToy().open, 2, executor=executor).simulate(rows_of(40, 35))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=":0",  # any free port: another test may have a cluster
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as cluster:
        yield cluster


@pytest.mark.slow
def test_a_worker_of_a_cluster_killed_half_way_costs_nothing(cluster: Any):
    from simulation.pool.dask_executor import DaskExecutor

    rows = ToyRC().parameter_space.from_unit(np.random.default_rng(3).random((300, 2)))
    n_done, children = 0, []
    answers = np.zeros((300, len(ToyRC().time), 1))
    with DaskExecutor(cluster.scheduler_address) as executor:
        model = PoolModel(SlowToy(row_s=0.03).open, executor=executor)
        for numbers, answer, _ in model.as_finished(rows):
            answers[numbers] = answer.y
            n_done += answer.n
            if n_done >= 100 and not children:
                pid = cluster.workers[1].process.pid
                children = psutil.Process(pid).children(recursive=True)
                os.kill(pid, signal.SIGKILL)
    assert n_done == 300
    assert np.array_equal(answers, ToyRC().simulate(rows).y)
    # What simulated for it went with it.
    assert children
    assert not psutil.wait_procs(children, timeout=100)[1]


def test_the_fmu_travels_by_its_content(cluster: Any, decay_case: Path):
    from simulation.pool.dask_executor import DaskExecutor

    case = load_case(decay_case)
    rows = np.column_stack([np.geomspace(2e-5, 5e-4, 30), np.zeros(30)])
    with case.open_model() as here:
        expected = here.simulate(rows)
    with DaskExecutor(cluster.scheduler_address) as executor:
        model = PoolModel(case.make_model, executor=executor)
        # The other machines have another file under this name, or none.
        shutil.move(case.fmu.path, case.fmu.path.with_suffix(".away"))
        assert model.simulate(rows).digest == expected.digest
        assert model.simulate(rows[::-1]).digest == expected.take(np.arange(30)[::-1]).digest


def test_a_command_simulates_on_a_cluster(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    root = make_project(tmp_path / "project")
    monkeypatch.chdir(root)
    digests = []
    for more in ((), ("--dask", cluster.scheduler_address)):
        capsys.readouterr()
        assert main(["simulate", "--profile", "smoke", "--json", *more]) == 0
        (stage,) = json.loads(capsys.readouterr().out)["stages"]
        assert stage["n_reused"] == 0
        digests.append(stage["digests"])
        shutil.rmtree(root / "data" / "office" / "generated")
    assert digests[0] == digests[1]
