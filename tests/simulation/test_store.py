"""The store: every row once, exactly, whatever happens to its files and whoever else uses it."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulation.counting import CountingModel
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.file_lock import FileLock
from simulation.store.folder import groups_to_merge
from simulation.store.index import Entries, RowIndex
from simulation.store.parts import Part, write_part
from simulation.store.rows import Layout, Rows
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.toy import ToyRC
from simulation.trajectories import Trajectories

MODEL = ToyRC(fails_above_r=4.0)
ROOT = Path(__file__).parents[2]
Warnings = list[str]


def design(n: int, seed: int = 0) -> np.ndarray:
    return uniform_design(MODEL.parameter_space, n, seed)


def open_store(folder: Path, warnings: Warnings | None = None, *, digest: str = "abc") -> SimulationStore:
    say = warnings.append if warnings is not None else pytest.fail
    return SimulationStore(
        folder,
        model_digest=digest,
        parameter_names=MODEL.parameter_space.names,
        output_names=MODEL.output_names,
        time=MODEL.time,
        on_warning=say,
    )


def parts(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.parquet"))


def failed(theta: np.ndarray, reason: str) -> Trajectories:
    y = np.full((len(theta), len(MODEL.time), 1), np.nan)
    return Trajectories(
        theta, y, MODEL.time, MODEL.parameter_space.names, MODEL.output_names, (reason,) * len(theta)
    )


@pytest.mark.parametrize("n", [1, 7, 300])
def test_rows_come_back_bit_for_bit_in_any_order_also_after_opening_again(tmp_path: Path, n: int) -> None:
    answer = MODEL.simulate(design(n))
    assert answer.failed.any() or n == 1
    with open_store(tmp_path) as store:
        assert not store.find(design(n)).any()
        store.append(answer)
    with open_store(tmp_path) as store:
        assert store.find(design(n)).all()
        assert not store.find(design(n, seed=1)).any()
        order = np.random.default_rng(0).integers(n, size=2 * n)
        assert store.read(design(n)[order]).digest == answer.take(order).digest
        assert np.array_equal(store.find_failed(design(n)), answer.failed)


def test_a_row_is_known_by_its_exact_bytes(tmp_path: Path) -> None:
    theta = np.array([[1.0, 0.0], [np.nan, 1.0]])
    with open_store(tmp_path) as store:
        store.append(failed(theta, "told"))
        assert store.find(theta).all()
        assert not store.find(np.array([[1.0, -0.0], [np.nextafter(1.0, 2.0), 0.0]])).any()
        with pytest.raises(LookupError, match="1 of 2 rows are not in"):
            store.read(np.array([[1.0, 0.0], [1.0, -0.0]]))


def test_a_store_is_written_and_read_without_pandas(tmp_path: Path) -> None:
    """Importing it takes as long as a small command."""
    script = """
import sys
import numpy as np
from simulation.design import uniform_design
from simulation.store.store import SimulationStore
from simulation.toy import ToyRC
model = ToyRC(fails_above_r=4.0)
names = {"parameter_names": model.parameter_space.names, "output_names": model.output_names}
with SimulationStore(sys.argv[1], model_digest="abc", time=model.time, **names) as store:
    rows = model.simulate(uniform_design(model.parameter_space, 20, 0))
    store.append(rows)
with SimulationStore(sys.argv[1], model_digest="abc", time=model.time, **names) as store:
    again = store.read(rows.theta)
assert rows.failed.any() and again.failures == rows.failures
np.testing.assert_array_equal(again.y, rows.y)
assert "pandas" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script, tmp_path], check=True, cwd=ROOT)


def test_pandas_reads_a_store_in_one_line_as_its_readme_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pandas

    answer = MODEL.simulate(design(20))
    with open_store(tmp_path) as store:
        store.append(answer.take(np.arange(12)))
        store.append(answer.take(np.arange(12, 20)))
    (tmp_path / ".part-1.parquet.tmp").write_text("half")
    monkeypatch.chdir(tmp_path)
    (line,) = [line for line in (tmp_path / "_README.txt").read_text().splitlines() if "pandas.read" in line]
    namespace = {"pandas": pandas}
    exec(line.strip(), namespace)
    rows = namespace["rows"]
    assert np.array_equal(rows[list(MODEL.parameter_space.names)].to_numpy(), answer.theta)
    assert np.array_equal(np.stack(rows[MODEL.output_names[0]]), answer.y[:, :, 0], equal_nan=True)
    assert tuple(rows["_failure"]) == answer.failures
    manifest = json.loads((tmp_path / "_store.json").read_text())
    assert manifest["time_s"] == MODEL.time.tolist()


def test_a_good_row_takes_the_place_of_a_failed_one_and_stays(tmp_path: Path) -> None:
    theta = design(50)[MODEL.simulate(design(50)).failed == 0][:3]
    good = MODEL.simulate(theta)
    with open_store(tmp_path) as store:
        store.append(failed(theta, "no licence"))
        store.append(failed(theta[:1], "still no licence"))
        assert store.read(theta).failures == ("still no licence", "no licence", "no licence")
        store.append(good.take([0, 1]))
        store.append(failed(theta, "too late"))
    for _ in range(2):
        with open_store(tmp_path) as store:
            found = store.read(theta)
            assert found.failures == ("", "", "too late")
            assert found.take([0, 1]).digest == good.take([0, 1]).digest
            assert len(store.theta) == 3


def test_a_reason_may_hold_bytes_that_are_no_text(tmp_path: Path) -> None:
    with open_store(tmp_path) as store:
        store.append(failed(design(2), "solver: \udcfc\n\tgröße"))
        assert store.read(design(2)).failures == ("solver: \\udcfc\n\tgröße",) * 2


def test_many_small_appends_end_in_few_files(tmp_path: Path) -> None:
    answer = MODEL.simulate(design(200))
    with open_store(tmp_path) as store:
        for row in range(200):
            store.append(answer.take([row]))
        assert len(parts(tmp_path)) < 50
        assert store.read(design(200)).digest == answer.digest
    with open_store(tmp_path) as store:
        assert store.read(design(200)).digest == answer.digest
        assert len(store.theta) == 200


def test_merging_parts_whose_last_ones_are_replaced_leaves_no_empty_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simulation.store.rows.GROUP_BYTES", 1)
    good = MODEL.simulate(np.array([[1.0, 1e4]]))
    with open_store(tmp_path) as store:
        store.append(good)
        for _ in range(15):
            store.append(failed(good.theta, "too late"))
        assert store.read(good.theta).digest == good.digest
    (part,) = parts(tmp_path)
    assert pyarrow.parquet.ParquetFile(part).num_row_groups == 1


def test_an_empty_group_is_no_damage(tmp_path: Path) -> None:
    rows = Rows(MODEL.simulate(design(2)), np.zeros(2, dtype=np.int64))
    layout = Layout("abc", MODEL.parameter_space.names, MODEL.output_names, MODEL.time)
    with (tmp_path / "part").open("wb") as file:
        write_part(file, layout, [rows.take(np.zeros(2, dtype=np.bool_))])
    part = Part(tmp_path / "part", layout)
    assert [block.n for block in part.blocks()] == [0]
    part.close()


def test_parts_are_merged_by_size() -> None:
    sizes = {f"small-{i:02d}": 9_000 for i in range(20)} | {f"large-{i:02d}": 3 * 2**20 for i in range(15)}
    assert groups_to_merge(sizes) == [[f"small-{i:02d}" for i in range(20)]]
    final = {f"block-{i}": 64 * 2**20 for i in range(100)}
    assert groups_to_merge(final) == []


def test_two_processes_share_a_store_while_parts_are_merged_under_them(tmp_path: Path) -> None:
    answer = MODEL.simulate(design(120))
    with open_store(tmp_path) as one, open_store(tmp_path) as other:
        for row in range(0, 120, 2):
            one.append(answer.take([row]))
            assert other.read(design(120)[: row + 1 : 2]).n == row // 2 + 1
            other.append(answer.take([row + 1]))
        for store in (one, other):
            assert store.find(design(120)).all()
            assert store.read(design(120)).digest == answer.digest
    assert len(parts(tmp_path)) < 60


def test_a_stream_is_the_same_rows_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = MODEL.simulate(design(100))
    with open_store(tmp_path) as store:
        store.append(answer)
        monkeypatch.setattr("simulation.store.store.BLOCK_BYTES", 30 * 8 * len(MODEL.time))
        blocks = list(store.stream(design(100)[::-1]))
        assert [block.n for block in blocks] == [30, 30, 30, 10]
        assert Trajectories.concatenate(blocks).digest == answer.take(np.arange(100)[::-1]).digest
        assert Trajectories.concatenate(list(store.stream())).digest == answer.digest


def test_a_store_of_another_model_is_refused_in_one_line(tmp_path: Path) -> None:
    open_store(tmp_path).close()
    with pytest.raises(
        InputError, match=r"_store\.json: model_digest is 'abc', this model has 'xyz'; remove"
    ) as told:
        open_store(tmp_path, digest="xyz")
    assert "\n" not in str(told.value)
    manifest = tmp_path / "_store.json"
    manifest.write_text(manifest.read_text().replace('"schema": 1', '"schema": 0'))
    with pytest.raises(InputError, match="schema is 0, this model has 1"):
        open_store(tmp_path)
    manifest.write_text("{")
    with pytest.raises(InputError, match="not readable; remove the file"):
        open_store(tmp_path)
    with pytest.raises(InputError, match="not readable; remove the file"):
        SimulationStore.at(tmp_path)
    with pytest.raises(InputError, match="no such file; simulate first"):
        SimulationStore.at(tmp_path / "none")
    with pytest.raises(InputError, match="'_check' names two columns"):
        SimulationStore(
            tmp_path, model_digest="a", parameter_names=("_check",), output_names=("R",), time=MODEL.time
        )


def test_an_initial_state_may_be_an_output_as_well(tmp_path: Path) -> None:
    answer = replace(MODEL.simulate(design(20)), output_names=("C",))
    for is_new in (True, False):
        with SimulationStore(
            tmp_path, model_digest="a", parameter_names=("R", "C"), output_names=("C",), time=MODEL.time
        ) as store:
            if is_new:
                store.append(answer)
            assert store.read(answer.theta).digest == answer.digest
    (part,) = parts(tmp_path)
    assert pyarrow.parquet.read_schema(part).names[:3] == ["R", "_parameter_C", "C"]


def test_rows_of_other_names_are_refused(tmp_path: Path) -> None:
    rows = MODEL.simulate(design(3))
    other = Trajectories(
        rows.theta, rows.y, rows.time + 1.0, rows.parameter_names, rows.output_names, rows.failures
    )
    with open_store(tmp_path) as store, pytest.raises(ValueError, match="other names or times"):
        store.append(other)


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda whole: whole[: len(whole) // 2],
    "garbage": lambda whole: b"not a part",
    "empty": lambda whole: b"",
    "footer": lambda whole: whole[:-200] + bytes(150) + whole[-50:],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_part_is_set_aside_and_its_rows_are_missing(tmp_path: Path, damage: str) -> None:
    answer, warnings = MODEL.simulate(design(30)), []
    with open_store(tmp_path) as store:
        store.append(answer.take(np.arange(20)))
        store.append(answer.take(np.arange(20, 30)))
    first = parts(tmp_path)[0]
    first.write_bytes(DAMAGES[damage](first.read_bytes()))
    with open_store(tmp_path, warnings) as store:
        assert store.find(design(30)).tolist() == [False] * 20 + [True] * 10
    assert len(warnings) == 1
    assert f"{first.name}: " in warnings[0]
    assert "moved to _damaged/, its rows are simulated again when needed" in warnings[0]
    assert (tmp_path / "_damaged" / first.name).is_file()
    with open_store(tmp_path) as store:
        assert len(store.theta) == 10


def test_no_flipped_bit_becomes_a_wrong_number(tmp_path: Path) -> None:
    answer = MODEL.simulate(design(30))
    with open_store(tmp_path / "whole") as store:
        store.append(answer)
    whole = parts(tmp_path / "whole")[0].read_bytes()
    rng, n_noticed, n_saved = np.random.default_rng(0), 0, 0
    for trial in range(150):
        folder, content = tmp_path / str(trial), bytearray(whole)
        content[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        folder.mkdir()
        (folder / "part-1.parquet").write_bytes(content)
        warnings: Warnings = []
        with open_store(folder, warnings) as store:
            model = StoredModel(MODEL, store)
            assert model.simulate(design(30)).digest == answer.digest
            n_noticed += bool(warnings)
            n_saved += bool(warnings) and model.n_simulated < 30
    assert n_noticed > 100
    assert n_saved > 20


def test_an_undamaged_row_of_a_damaged_part_is_kept(tmp_path: Path) -> None:
    answer, warnings = MODEL.simulate(design(30)), []
    with open_store(tmp_path) as store:
        store.append(answer)
    (part,) = parts(tmp_path)
    table = pyarrow.parquet.read_table(part)
    checks = table["_check"].to_numpy().copy()
    checks[7] += 1
    columns = [*table.columns[:-1], pyarrow.array(checks)]
    pyarrow.parquet.write_table(pyarrow.table(columns, schema=table.schema), part)
    theta, counting = design(30), CountingModel(MODEL)
    with open_store(tmp_path, warnings) as store:
        model = StoredModel(counting, store)
        assert model.simulate(theta).digest == answer.digest
        assert counting.n_calls == 1
    assert "its undamaged rows are kept" in warnings[0]


def test_leftovers_of_killed_writers_go_when_nobody_writes(tmp_path: Path) -> None:
    open_store(tmp_path).close()
    leftovers = [tmp_path / name for name in (".part-1-aaaaaaaa.parquet.tmp", "._store.json.aaaaaaaa.tmp")]
    for leftover in leftovers:
        leftover.write_bytes(b"half")
    with FileLock(tmp_path / ".writers", shared=True):
        open_store(tmp_path).close()
        assert all(leftover.exists() for leftover in leftovers)
    open_store(tmp_path).close()
    assert not any(leftover.exists() for leftover in leftovers)


FULL_DISK = """
import resource, sys
from pathlib import Path
sys.path.insert(0, {root!r})
from simulation.design import uniform_design
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.toy import ToyRC

model = ToyRC()
store = SimulationStore(
    Path({folder!r}),
    model_digest="abc",
    parameter_names=model.parameter_space.names,
    output_names=model.output_names,
    time=model.time,
)
stored = StoredModel(model, store)
theta = uniform_design(model.parameter_space, 400, 0)
stored.simulate(theta[:20])
# No file may grow beyond this: what a full disk is to a part.
resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, 8_000))
for start in range(20, 400, 20):
    try:
        stored.simulate(theta[start : start + (20 if start < 200 else 200)])
    except OSError as error:
        print(start, error.errno, error.strerror)
        break
"""


def test_a_full_disk_is_one_error_and_loses_nothing(tmp_path: Path) -> None:
    script = FULL_DISK.format(root=str(ROOT), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    n_stored, number, reason = done.stdout.split(maxsplit=2)
    assert (int(number), reason.strip()) == (27, "File too large")
    assert not list(tmp_path.glob(".*.tmp"))
    model, theta = ToyRC(), uniform_design(ToyRC().parameter_space, 400, 0)
    with SimulationStore.at(tmp_path, on_warning=pytest.fail) as store:
        assert store.find(theta[: int(n_stored)]).all()
        assert store.read(theta[: int(n_stored)]).digest == model.simulate(theta[: int(n_stored)]).digest
        assert not store.find(theta[int(n_stored) :]).any()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.tuples(st.integers(0, 20), st.booleans()), max_size=8), max_size=12))
def test_an_index_is_a_dictionary_that_prefers_good_then_new(batches: list[list[tuple[int, bool]]]) -> None:
    index, expected, moment = RowIndex(1), {}, 0
    for number, batch in enumerate(batches):
        theta = np.array([[float(key)] for key, _ in batch]).reshape(len(batch), 1)
        good = np.array([is_good for _, is_good in batch], dtype=bool)
        written = np.arange(moment, moment + len(batch), dtype=np.int64)
        moment += len(batch)
        index.add([Entries.of_part(number, theta, good, written)])
        for row, (key, is_good) in enumerate(batch):
            if is_good >= expected.get(key, (False,))[0]:
                expected[key] = (is_good, number, row)
    known, found = index.look_up(np.arange(25.0)[:, None])
    assert {
        key: (bool(found.good[key]), int(found.part[key]), int(found.row[key]))
        for key in np.flatnonzero(known)
    } == expected
    assert len(index.all().keys) == len(expected)
    gone = {part for _, part, _ in expected.values()}
    index.drop(gone)
    known, found = index.look_up(np.arange(25.0)[:, None])
    assert gone.isdisjoint(found.part[known].tolist())
