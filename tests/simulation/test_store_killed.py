"""SIGKILL of masters and workers at 50 moments: no row once reported is lost, none is simulated twice."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from slow_models import SlowToy

from simulation.design import uniform_design
from simulation.store.store import SimulationStore
from simulation.toy import ToyRC

ROOT = Path(__file__).parents[2]
N_ROWS, N_MASTERS, N_WORKERS, N_CHUNK = 3000, 25, 25, 17
LIMIT_S = 240.0

CAMPAIGN = """
import os, sys
from pathlib import Path
sys.path[:0] = [{tests!r}, {root!r}]
from simulation.design import uniform_design
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.pool_model import PoolModel
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from slow_models import SlowToy

folder = Path({folder!r})
toy = SlowToy(row_s=0.003, begun=folder / "begun")
theta = uniform_design(toy.parameter_space, {n_rows}, 0)
reported = os.open(folder / "reported", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
policy = ExecutionPolicy(retries=9)
with SimulationStore(
    folder / "store",
    model_digest="toy",
    parameter_names=toy.parameter_space.names,
    output_names=toy.output_names,
    time=toy.time,
) as store, PoolModel(toy.open, 2, policy=policy) as model:
    stored = StoredModel(model, store)
    for row in store.find(theta).argmin() + range(5):
        stored.simulate(theta[row : row + 1])
        os.write(reported, b"%d\\n" % store.find(theta).sum())
    stored.complete(theta, on_progress=lambda n: os.write(reported, b"%d\\n" % n))
print("finished")
"""


def open_store(folder: Path) -> SimulationStore:
    toy = ToyRC()
    return SimulationStore(
        folder,
        model_digest="toy",
        parameter_names=toy.parameter_space.names,
        output_names=toy.output_names,
        time=toy.time,
        on_warning=pytest.fail,
    )


def begun(file: Path) -> list[bytes]:
    return [bytes.fromhex(line) for line in file.read_text().split()] if file.exists() else []


def reported(file: Path) -> int:
    lines = file.read_bytes().split(b"\n")[:-1] if file.exists() else []
    return int(lines[-1]) if lines else 0


def kill_a_worker(master: int, dice: random.Random) -> bool:
    """Kill one of the processes that simulate, or that supervise these: the master's child starts them."""
    try:
        supervisors = [each for child in psutil.Process(master).children() for each in child.children()]
        workers = [each for child in supervisors for each in child.children()]
        dice.choice(supervisors + workers).kill()
    except (psutil.NoSuchProcess, IndexError):
        return False
    return True


def test_no_reported_row_is_lost_or_simulated_twice_whoever_is_killed(tmp_path: Path) -> None:
    toy, dice = SlowToy(), random.Random(3)
    theta = uniform_design(toy.parameter_space, N_ROWS, 0)
    script = CAMPAIGN.format(
        tests=str(Path(__file__).parent), root=str(ROOT), folder=str(tmp_path), n_rows=N_ROWS
    )
    n_masters, n_workers, known_from = 0, 0, {}
    deadline = time.monotonic() + LIMIT_S
    with (tmp_path / "log").open("wb") as log:
        while True:
            assert time.monotonic() < deadline, (n_masters, n_workers)
            before = reported(tmp_path / "reported")
            process = subprocess.Popen([sys.executable, "-c", script], stdout=log, stderr=log)
            family: list[psutil.Process] = []
            if n_masters < N_MASTERS:
                # Some die while they start, most while they simulate.
                while dice.random() < 0.995 and reported(tmp_path / "reported") == before:
                    time.sleep(0.005)
                for _ in range(dice.randint(0, 2)):
                    time.sleep(dice.uniform(0.0, 0.1))
                    n_workers += n_workers < N_WORKERS and kill_a_worker(process.pid, dice)
                time.sleep(dice.uniform(0.0, 0.1))
                family = psutil.Process(process.pid).children(recursive=True)
                process.kill()
                n_masters += 1
            elif n_workers < N_WORKERS:
                while process.poll() is None and n_workers < N_WORKERS:
                    time.sleep(dice.uniform(0.0, 0.1))
                    n_workers += kill_a_worker(process.pid, dice)
            process.wait(LIMIT_S)
            _, alive = psutil.wait_procs(family, timeout=10)
            assert not alive, "workers outlive their master"
            with open_store(tmp_path / "store") as store:
                known = store.find(theta)
                assert known.sum() >= reported(tmp_path / "reported"), "a reported row is lost"
                n_begun = len(begun(tmp_path / "begun"))
                for row in theta[known]:
                    known_from.setdefault(row.tobytes(), n_begun)
            if process.returncode == 0:
                break
            assert process.returncode == -signal.SIGKILL, (tmp_path / "log").read_text()
    assert (n_masters, n_workers) == (N_MASTERS, N_WORKERS)
    for number, row in enumerate(begun(tmp_path / "begun")):
        assert number < known_from[row], "a row that was stored is simulated again"
    with open_store(tmp_path / "store") as store:
        assert store.read(theta).digest == ToyRC().simulate(theta).digest
        assert len(store.theta) == N_ROWS
    # What a killed process had in hand is the only thing that is done again: a chunk of 0.05 s.
    assert len(begun(tmp_path / "begun")) <= N_ROWS + N_CHUNK * (2 * N_MASTERS + N_WORKERS)
    assert not list((tmp_path / "store").glob(".*.tmp"))
