"""A stored model answers like the model, asks for no row twice, and shares its store with other processes."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from simulation.counting import CountingModel
from simulation.design import uniform_design
from simulation.store.row_set import RowSet, content_of
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.toy import ToyRC
from simulation.trajectories import Trajectories

ROOT = Path(__file__).parents[2]
TOY = ToyRC(fails_above_r=4.0)


def design(n: int, seed: int = 0) -> np.ndarray:
    return uniform_design(TOY.parameter_space, n, seed)


def open_store(folder: Path) -> SimulationStore:
    return SimulationStore(
        folder,
        model_digest="toy",
        parameter_names=TOY.parameter_space.names,
        output_names=TOY.output_names,
        time=TOY.time,
        on_warning=pytest.fail,
    )


@pytest.fixture
def store(tmp_path: Path) -> Iterator[SimulationStore]:
    with open_store(tmp_path / "store") as store:
        yield store


def test_known_and_new_rows_may_be_mixed_and_repeated(store: SimulationStore) -> None:
    counting = CountingModel(TOY)
    model = StoredModel(counting, store)
    model.simulate(design(40)[::2])
    order = np.random.default_rng(0).integers(40, size=100)
    assert model.simulate(design(40)[order]).digest == TOY.simulate(design(40)[order]).digest
    assert counting.n_calls == len(set(order.tolist()) | set(range(0, 40, 2)))
    assert model.n_simulated == counting.n_calls
    assert model.n_simulated + model.n_reused == 120


def test_calls_are_counted_above_the_store_as_asked(store: SimulationStore) -> None:
    StoredModel(TOY, store).simulate(design(30))
    asked = CountingModel(StoredModel(TOY, store))
    asked.simulate(design(30))
    asked.simulate(design(40))
    assert asked.n_calls == 70


def test_progress_begins_with_what_is_known(store: SimulationStore) -> None:
    model, seen = StoredModel(TOY, store), []
    model.complete(design(20))
    model.complete(design(200), on_progress=seen.append)
    assert (seen[0], seen[-1]) == (20, 200)
    assert seen == sorted(seen)
    assert (
        Trajectories.concatenate(list(model.stream(design(200)))).digest == TOY.simulate(design(200)).digest
    )


class Licensed(CountingModel):
    """The toy, every row of which fails while there is no licence."""

    has_licence = False

    def simulate(self, theta: np.ndarray) -> Trajectories:
        answer = super().simulate(theta)
        if self.has_licence:
            return answer
        return Trajectories.checked(
            theta,
            answer.y,
            time=answer.time,
            parameter_names=answer.parameter_names,
            output_names=answer.output_names,
            failures=["no licence"] * answer.n,
        )


def test_failed_rows_are_asked_again_once_and_on_request(store: SimulationStore) -> None:
    toy = Licensed(ToyRC())
    assert set(StoredModel(toy, store).simulate(design(10)).failures) == {"no licence"}
    assert set(StoredModel(toy, store).simulate(design(10)).failures) == {"no licence"}
    assert toy.n_calls == 10
    patient = StoredModel(toy, store, retry_failed=True)
    assert set(patient.simulate(design(10)).failures) == {"no licence"}
    patient.simulate(design(10))
    assert toy.n_calls == 20
    assert patient.failures == ["no licence"] * 20
    toy.has_licence = True
    again = StoredModel(toy, store, retry_failed=True)
    assert again.simulate(design(10)).digest == ToyRC().simulate(design(10)).digest
    again.simulate(design(10))
    assert toy.n_calls == 30
    assert again.failures == []


def test_a_clock_that_is_put_back_neither_hides_nor_repeats_a_failed_row(
    store: SimulationStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy, now = Licensed(ToyRC()), time.time_ns()
    monkeypatch.setattr("time.time_ns", lambda: now + 10**15)
    StoredModel(toy, store).simulate(design(10))
    monkeypatch.undo()
    with open_store(tmp_path / "store") as reopened:
        patient = StoredModel(toy, reopened, retry_failed=True)
        patient.simulate(design(10))
        patient.simulate(design(10))
        assert toy.n_calls == 20
        toy.has_licence = True
        again = StoredModel(toy, reopened, retry_failed=True)
        assert again.simulate(design(10)).digest == ToyRC().simulate(design(10)).digest


class Breaking(CountingModel):
    """The toy, which stops in the middle of a campaign."""

    def simulate(self, theta: np.ndarray) -> Trajectories:
        if self.n_calls >= 128:
            raise KeyboardInterrupt
        return super().simulate(theta)


def test_an_interrupted_batch_keeps_the_blocks_that_were_finished(store: SimulationStore) -> None:
    with pytest.raises(KeyboardInterrupt):
        StoredModel(Breaking(TOY), store).simulate(design(500))
    assert store.find(design(500)).sum() == 128
    model = StoredModel(TOY, store)
    assert model.simulate(design(500)).digest == TOY.simulate(design(500)).digest
    assert model.n_simulated == 372


WRITER = """
import sys
from pathlib import Path
sys.path.insert(0, {root!r})
from simulation.design import uniform_design
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.toy import ToyRC

toy, number = ToyRC(fails_above_r=4.0), int(sys.argv[1])
theta = uniform_design(toy.parameter_space, 240, 0)
with SimulationStore.at(Path({folder!r}), on_warning=sys.exit) as store:
    model = StoredModel(toy, store)
    for row in range(number, 240, 3):
        # Its own new row, and one that another process may just be storing or merging.
        assert model.simulate(theta[[row, max(0, row - 1)]]).n == 2
        assert store.find(theta[number : row + 1 : 3]).all()
"""


def test_three_processes_write_read_and_merge_one_store(tmp_path: Path) -> None:
    folder = tmp_path / "store"
    open_store(folder).close()
    script = WRITER.format(root=str(ROOT), folder=str(folder))
    writers = [subprocess.Popen([sys.executable, "-c", script, str(number)]) for number in range(3)]
    with open_store(folder) as store:
        while any(writer.poll() is None for writer in writers):
            known = store.find(design(240))
            store.read(design(240)[known])
        assert [writer.returncode for writer in writers] == [0, 0, 0]
        assert store.read(design(240)).digest == TOY.simulate(design(240)).digest
    with open_store(folder) as store:
        assert len(store.theta) == 240
    assert len(list(folder.glob("part-*"))) < 60
    assert not list(folder.glob(".*.tmp"))


def test_a_set_is_its_rows_and_moves_with_the_store(store: SimulationStore, tmp_path: Path) -> None:
    StoredModel(TOY, store).complete(design(50))
    answer = TOY.simulate(design(50))
    (tmp_path / "sets").mkdir()
    RowSet(design(50), store.folder, tmp_path / "sets" / "train.npz").save()
    moved = tmp_path.rename(tmp_path.with_name("moved"))
    found = RowSet.load(moved / "sets" / "train.npz")
    assert found.read().digest == answer.digest
    assert found.read(20).digest == answer.take(np.arange(20)).digest
    assert found.n == 50


def test_the_content_of_a_set_does_not_depend_on_blocks() -> None:
    answer = TOY.simulate(design(50))
    blocks = [answer.take(np.arange(start, min(start + 7, 50))) for start in range(0, 50, 7)]
    assert content_of(iter([answer])) == content_of(iter(blocks))
    assert content_of(iter(blocks[:-1])).digest != content_of(iter(blocks)).digest
    assert content_of(iter(blocks)).failures == answer.failures
