"""SIGKILL at 50 moments of a running batch: no stored row is lost, none is simulated again."""

import multiprocessing
import os
import random
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from slow_models import SlowToy
from toy_rc import ToyRC

from simulation import Trajectories, uniform_design
from simulation.arrays import FloatArray, IntArray
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel

N_ROWS, N_KILLS, CHUNK, LIMIT_S = 3000, 50, 5, 240.0
THETA = uniform_design(ToyRC().parameter_space, N_ROWS, 0)


@dataclass(frozen=True, eq=False)
class Finishing(SlowToy):
    """The toy, which hands over some rows at a time, the last ones first."""

    def as_finished(self, theta: FloatArray) -> Generator[tuple[IntArray, Trajectories]]:
        for rows in np.array_split(np.arange(len(theta))[::-1], -(-len(theta) // CHUNK)):
            yield rows, self.simulate(theta[rows])


def open_store(folder: Path) -> SimulationStore:
    toy = ToyRC()
    names = {"parameter_names": toy.parameter_space.names, "output_names": toy.output_names}
    return SimulationStore(folder / "toy.db", model_digest="toy", time=toy.time, **names)


def simulate_all(folder: Path) -> None:
    reported = os.open(folder / "reported", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    with open_store(folder) as store:
        model = StoredModel(Finishing(row_s=0.0005, begun=folder / "begun"), store)
        model.complete(THETA, on_progress=lambda n: os.write(reported, b"%d\n" % n))


def test_no_reported_row_is_lost_or_simulated_again(tmp_path: Path) -> None:
    dice, n_killed, known_from = random.Random(3), 0, dict[str, int]()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["simulation.store.stored_model", "toy_rc", "simulation.design"])
    reported, begun = tmp_path / "reported", tmp_path / "begun"
    for file in (reported, begun):
        file.touch()

    def n_reported() -> int:
        return int(b"0%s" % b"".join(reported.read_bytes().split(b"\n")[-2:-1]))

    deadline = time.monotonic() + LIMIT_S
    while n_reported() < N_ROWS:
        assert time.monotonic() < deadline, n_killed
        process, before = context.Process(target=simulate_all, args=(tmp_path,)), n_reported()
        process.start()
        if n_killed < N_KILLS:
            # Some die while they start, most while they simulate or store.
            while process.is_alive() and dice.random() < 0.99 and n_reported() <= before + 2 * CHUNK:
                time.sleep(0.001)
            time.sleep(dice.uniform(0.0, 0.02))
            n_killed += process.is_alive()
            process.kill()
        process.join(LIMIT_S)
        with open_store(tmp_path) as store:
            known = store.find(THETA)
            assert known.sum() >= n_reported(), "a reported row is lost"
            n_begun = len(begun.read_text().split())
            for row in THETA[known]:
                known_from.setdefault(row.tobytes().hex(), n_begun)
    assert n_killed == N_KILLS
    rows = begun.read_text().split()
    for number, row in enumerate(rows):
        assert number < known_from[row], "a row that was stored is simulated again"
    # What a killed process had begun and not stored is the only thing that is done again.
    assert len(rows) <= N_ROWS + CHUNK * N_KILLS
    with open_store(tmp_path) as store:
        assert store.read(THETA).digest == ToyRC().simulate(THETA).digest
        assert len(store.theta) == N_ROWS
