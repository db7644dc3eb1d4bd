"""The store and the model around it: every row once, exactly, whatever happens to the file."""

import multiprocessing
import os
import re
import resource
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_rc import ToyRC

from simulation import CountingModel, InputError, Trajectories, uniform_design
from simulation.arrays import FloatArray
from simulation.errors import MachineError
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from studies.cli import help_of

TOY = ToyRC(fails_above_r=4.0)
OWN_FMU = Path(__file__).parents[2] / "docs" / "own-fmu.md"
PROCESSES = multiprocessing.get_context("forkserver")


def design(n: int, seed: int = 0) -> FloatArray:
    return uniform_design(TOY.parameter_space, n, seed)


ANSWER = TOY.simulate(design(400))


def open_store(file: Path, digest: str = "toy", rows: Trajectories = ANSWER) -> SimulationStore:
    names = {"parameter_names": rows.parameter_names, "output_names": rows.output_names}
    return SimulationStore(file, model_digest=digest, time=rows.time, **names)


def simulated(store: SimulationStore, n: int) -> bool:
    return StoredModel(TOY, store).simulate(design(n)).digest == ANSWER.take(np.arange(n)).digest


def failed(rows: Trajectories, reason: str) -> Trajectories:
    return replace(rows, y=np.full_like(rows.y, np.nan), failures=(reason,) * rows.n)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "simulations" / "toy.db"


@pytest.fixture
def store(file: Path) -> Iterator[SimulationStore]:
    with open_store(file) as store:
        yield store


def test_rows_come_back_bit_for_bit_in_any_order_and_in_blocks(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_store(file) as store:
        assert not store.find(design(400)).any()
        store.append(ANSWER.take([]))
        store.append(ANSWER)
        assert np.array_equal(store.theta, design(400))
    monkeypatch.setattr("simulation.store.store.BLOCK_BYTES", 300 * 8 * len(TOY.time))
    order = np.random.default_rng(0).integers(400, size=700)
    with SimulationStore.at(file) as store:
        assert np.array_equal(store.find_good(design(400)), ~ANSWER.failed)
        blocks = list(store.stream(design(400)[order]))
    assert [block.n for block in blocks] == [300, 300, 100]
    assert Trajectories.concatenate(blocks).digest == ANSWER.take(order).digest


def test_a_row_is_known_by_its_exact_bytes(store: SimulationStore) -> None:
    StoredModel(TOY, store).complete(np.array([[1.0, 0.0], [np.nan, 1.0], [np.nan, 1.0]]))
    theta = np.array([[np.nan, 1.0], [1.0, 0.0], [1.0, -0.0], [np.nextafter(1.0, 2.0), 0.0]])
    assert store.find(theta).tolist() == [True, True, False, False]
    with pytest.raises(LookupError, match="2 of 4 rows are not in"):
        store.read(theta)
    assert np.signbit(StoredModel(TOY, store).simulate(theta).theta[:, 1]).sum() == 1


def test_pandas_reads_a_store_as_the_page_and_the_help_say(store: SimulationStore) -> None:
    store.append(ANSWER)
    (shown,) = re.findall(r"^```py\n(.*?)^```$", OWN_FMU.read_text(), flags=re.MULTILINE | re.DOTALL)
    found: dict[str, Any] = {"FILE": store.file}
    exec(shown.replace('"TAir"', '"T"'), found)
    assert np.array_equal(found["rows"][list(ANSWER.parameter_names)], ANSWER.theta)
    assert np.array_equal(found["y"], ANSWER.y[:, :, 0], equal_nan=True)
    assert tuple(found["rows"]["_failure"]) == ANSWER.failures
    assert np.array_equal(found["time"], TOY.time)
    assert all(
        line in help_of("simulate")[1]
        for line in re.findall(r"(?:pandas.read_sql|numpy.stack).*\)", shown)[:2]
    )


def test_a_good_row_takes_the_place_of_a_failed_one_and_stays(store: SimulationStore) -> None:
    good = ANSWER.take(np.flatnonzero(~ANSWER.failed)[:3])
    for rows in (
        failed(good, "no licence"),
        failed(good.take([0, 2]), "solver: \udcfc\n\tgröße"),
        good.take([0, 1]),
        failed(good.take([0, 1]), "too late"),
    ):
        store.append(rows)
    assert store.read(good.theta).failures == ("", "", "solver: \\udcfc\n\tgröße")
    assert store.read(good.theta[:2]).digest == good.take([0, 1]).digest
    assert len(store.theta) == 3


def test_what_is_not_this_models_store_is_refused_in_one_line(file: Path, store: SimulationStore) -> None:
    with pytest.raises(InputError, match=r"db: model_digest is 'toy', this model has 'x'; remove the file"):
        open_store(file, "x")
    for missing in (file.with_name("none.db"), file.parent):
        with pytest.raises(InputError, match=f"{missing}: no simulations are stored there; type"):
            SimulationStore.at(missing)
    with pytest.raises(ValueError, match="other names or times"):
        store.append(replace(ANSWER, time=TOY.time + 1.0))


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda whole: whole[: len(whole) // 2],
    "garbage": lambda whole: b"no database at all" * 100,
    "first page": lambda whole: whole[:100] + bytes(3996) + whole[4096:],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_one_line_that_names_it_and_the_remedy(file: Path, damage: str) -> None:
    with open_store(file) as store:
        store.append(ANSWER)
        left = file.with_name("toy.db-wal").read_bytes()
    file.write_bytes(DAMAGES[damage](file.read_bytes()))
    assert re.fullmatch(f"{file}: .*; it is damaged: remove it, with .* run again", what_is_said(file))
    file.unlink()
    # What a killed process left beside a file that was removed does not get into the next one.
    file.with_name("toy.db-wal").write_bytes(left)
    with open_store(file) as store:
        assert len(store.theta) == 0
    assert what_is_said(file) == ""


def what_is_said(file: Path) -> str:
    try:
        with open_store(file) as store:
            assert simulated(store, 30)
    except InputError as error:
        return str(error)
    return ""


def test_no_flipped_bit_becomes_a_wrong_number(file: Path) -> None:
    with open_store(file) as store:
        simulated(store, 30)
    whole, rng, n_removed = file.read_bytes(), np.random.default_rng(0), 0
    for _ in range(75):
        content = bytearray(whole)
        content[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(content)
        while said := what_is_said(file):
            # One row is removed by itself, a file by the user.
            n_removed += "1 of 30 simulations were damaged and are removed; type" in said
            if "are removed; type" not in said:
                assert re.fullmatch(f"{file}: .*(remove (it|the file)|move it away).*", said)
                file.unlink()
    assert n_removed > 5


def in_a_process(work: Callable[..., None], *arguments: object) -> multiprocessing.process.BaseProcess:
    process = PROCESSES.Process(target=work, args=arguments)
    process.start()
    return process


def write_until_the_disk_is_full(file: Path) -> None:
    with open_store(file) as store:
        simulated(store, 20)
        # No file may grow beyond this: what a full disk is to a database.
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        with pytest.raises(MachineError, match=f"{file}: .*; .*, then type .*: what is stored is kept"):
            all(simulated(store, n) for n in range(40, 400, 20))


def test_a_full_disk_is_one_line_and_loses_nothing(file: Path) -> None:
    process = in_a_process(write_until_the_disk_is_full, file)
    process.join()
    with SimulationStore.at(file) as store:
        n_stored = int(store.find(design(400)).sum())
        assert (process.exitcode, n_stored % 20) == (0, 0)
        assert 20 < n_stored < 400
        assert store.read(design(n_stored)).digest == ANSWER.take(np.arange(n_stored)).digest
        assert simulated(store, 400)


def read_without_permission(file: Path) -> None:
    if os.getuid() == 0:
        os.setuid(65534)
    with open_store(file) as store:
        assert simulated(store, 30)
        with pytest.raises(MachineError, match="readonly database; allow writing there"):
            simulated(store, 31)


def test_a_project_that_cannot_be_written_is_read(file: Path) -> None:
    with open_store(file) as store:
        simulated(store, 30)
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(file, folder)
        Path(folder).chmod(0o555)
        process = in_a_process(read_without_permission, Path(folder) / file.name)
        process.join()
        Path(folder).chmod(0o755)
    assert process.exitcode == 0


def write_every_third_row(file: Path, first: int) -> None:
    with open_store(file) as store:
        for row in range(first, 240, 3):
            # Its own new row, and one that another process may just be storing.
            theta = design(240)[[row, max(0, row - 1)]]
            assert StoredModel(TOY, store).simulate(theta).n == 2
            assert store.find(design(240)[first : row + 1 : 3]).all()


def test_three_processes_make_write_and_read_one_store(file: Path) -> None:
    writers = [in_a_process(write_every_third_row, file, first) for first in range(3)]
    with open_store(file) as store:
        while any(writer.is_alive() for writer in writers):
            store.read(design(240)[store.find(design(240))])
        assert [writer.exitcode for writer in writers] == [0, 0, 0]
        assert store.read(design(240)).digest == ANSWER.take(np.arange(240)).digest
        assert len(store.theta) == 240
    assert sorted(one.name for one in file.parent.iterdir()) == [".making", "toy.db"]


class Licensed(CountingModel):
    """The toy, every row of which fails while there is no licence."""

    has_licence = False

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = super().simulate(theta)
        return answer if self.has_licence else failed(answer, "no licence")


def test_failed_rows_are_asked_again_once_and_on_request(store: SimulationStore) -> None:
    toy = Licensed(ToyRC())
    for retry_failed, n_calls in ((False, 10), (False, 10), (True, 20)):
        model = StoredModel(toy, store, retry_failed=retry_failed)
        for _ in range(2):
            model.simulate(design(10))
        assert (toy.n_calls, model.failures) == (n_calls, ["no licence"] * 20)
    toy.has_licence = True
    again = StoredModel(toy, store, retry_failed=True)
    for _ in range(2):
        assert again.simulate(design(10)).digest == ToyRC().simulate(design(10)).digest
    assert (toy.n_calls, again.failures) == (30, [])
