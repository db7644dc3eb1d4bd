"""The records of a study: the same promises from files and from PostgreSQL."""

import shutil
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.tuning.claim import GRACE_S, Claim, is_dead, this_owner
from studies.tuning.postgres import Database, StorageAwayError
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord, record_to_json
from studies.tuning.trial_store import StudyEntry, TrialStore, list_studies, named_lock, open_trials

MakeSpec = Callable[..., StudySpec]


@pytest.fixture(params=["files", "postgres"])
def paths(request: pytest.FixtureRequest, tmp_path: Path) -> ProjectPaths:
    """A project on either storage."""
    return ProjectPaths(tmp_path, request.getfixturevalue("storage") if request.param == "postgres" else None)


@pytest.fixture
def store(paths: ProjectPaths, make_spec: MakeSpec) -> TrialStore:
    return open_trials(paths, make_spec())


def a_record(index: int, mae: float = 0.5, **changes: object) -> TrialRecord:
    record = TrialRecord(
        study="toy-small/n0016/00000000",
        n_train=16,
        index=index,
        state="complete",
        reason="",
        params={"beta": 1e-7 * (index + 1), "log2_n_latent": 3},
        config={"n_latent": 8, "max_epochs": 20},
        seed=index,
        started_s=1.7e9 + index,
        wall_s=1.0,
        digests={"case": "c"},
        owner=OWNER,
        metrics={"val/mae": mae},
        reports={"3": float("nan"), "9": float("inf"), "20": mae},
    )
    return replace(record, **changes)  # type: ignore[arg-type]


def a_claim(index: int) -> Claim:
    claim = Claim(
        index=index, params={"beta": 3.0}, config={}, seed=1, origin="gp", started_s=0.0, max_epochs=20
    )
    return claim.taken(this_owner(), 1.7e9)


def some_weights(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "weights.npz").write_bytes(b"weights")
    (folder / "surrogate.json").write_text("{}")
    return folder


OWNER = this_owner()
CURVES = {"epoch": np.arange(3), "loss": np.array([0.3, np.nan, 1e-300])}


def test_what_is_written_comes_back_to_the_last_bit(store: TrialStore, tmp_path: Path) -> None:
    for index in (2, 0, 1):
        assert store.write(a_record(index, 0.1 + index), CURVES, some_weights(tmp_path / f"w{index}"))
    assert store.finished() == [0, 1, 2]
    expected = [record_to_json(a_record(i, 0.1 + i)) for i in range(3)]
    assert [record_to_json(record) for record in store.records()] == expected
    again = store.record(1)
    assert again is not None
    assert record_to_json(again) == expected[1]
    assert store.record(3) is None
    np.testing.assert_array_equal(store.history(1)["loss"], CURVES["loss"])
    with pytest.raises(KeyError, match="no finished trial 7"):
        store.history(7)
    (tmp_path / "out").mkdir()
    assert store.fetch_surrogate(2, tmp_path / "out")
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == {
        "weights.npz": b"weights",
        "surrogate.json": b"{}",
    }


def test_gaps_are_allowed_and_new_records_are_seen_by_others(store: TrialStore, paths: ProjectPaths) -> None:
    other = open_trials(paths, store.name)
    store.write(a_record(4), CURVES)
    assert [record.index for record in other.records()] == [4]
    store.write(a_record(1), CURVES)
    assert [record.index for record in other.records()] == [1, 4]


def test_a_trial_finishes_once(store: TrialStore) -> None:
    assert store.write(a_record(0, 0.5), CURVES)
    assert not store.write(a_record(0, 0.7, started_s=1.8e9), CURVES)
    (kept,) = store.records()
    assert kept.metrics["val/mae"] == 0.5


def test_only_the_best_keeps_its_surrogate(store: TrialStore, tmp_path: Path) -> None:
    for index, mae in enumerate([0.3, 0.1, 0.2]):
        store.write(a_record(index, mae), CURVES, some_weights(tmp_path / f"w{index}"))
    store.keep_only_best()
    (tmp_path / "out").mkdir()
    assert [store.fetch_surrogate(index, tmp_path / "out") for index in range(3)] == [False, True, False]


def test_a_surrogate_that_is_removed_while_it_is_copied_is_gone(
    tmp_path: Path, make_spec: MakeSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_trials(ProjectPaths(tmp_path, None), make_spec())
    for index, mae in enumerate([0.3, 0.1]):
        store.write(a_record(index, mae), CURVES, some_weights(tmp_path / f"w{index}"))
    copied: list[str] = []

    def copy(source: str, target: str) -> None:
        shutil.copy2(source, target)
        copied.append(target)
        store.keep_only_best()

    monkeypatch.setattr(shutil, "copytree", partial(shutil.copytree, copy_function=copy))
    (tmp_path / "out").mkdir()
    assert not store.fetch_surrogate(0, tmp_path / "out")
    assert len(copied) == 1
    assert not list((tmp_path / "out").iterdir())
    assert not list(tmp_path.rglob(".surrogate"))
    assert store.fetch_surrogate(1, tmp_path / "out")


def test_claims_tell_who_works_and_how_far(store: TrialStore, paths: ProjectPaths) -> None:
    mine, lost = a_claim(0), a_claim(11).released(lost=True)
    store.put_claim(mine)
    store.put_claim(lost)
    store.beat(mine, epoch=7, value=0.25)
    store.beat(replace(mine, token="of somebody else"), epoch=9, value=9.0)
    other = open_trials(paths, store.name)
    (running,) = other.running()
    assert (running.index, running.owner, running.epoch, running.value) == (0, mine.owner, 7, 0.25)
    assert running.max_epochs == 20
    claims = other.claims()
    assert [claim for claim, _ in claims] == [mine, lost]
    assert 0.0 <= claims[0][1] < GRACE_S
    store.write(a_record(0), CURVES)
    assert [claim for claim, _ in other.claims()] == [lost]
    store.drop_claim(11)
    assert other.claims() == []


def test_an_owner_is_dead_when_its_process_is_or_when_it_was_silent_for_long() -> None:
    owner = this_owner()
    assert not is_dead(owner, 10 * GRACE_S)
    assert is_dead({**owner, "process_started_s": owner["process_started_s"] - 100.0}, 0.0)
    assert is_dead({**owner, "pid": 2**22 + 1}, 0.0)
    elsewhere = {**owner, "machine": "another/boot/pid:[1]"}
    assert not is_dead(elsewhere, 0.5 * GRACE_S)
    assert is_dead(elsewhere, 1.5 * GRACE_S)


def test_studies_are_listed_with_what_was_planned(paths: ProjectPaths, make_spec: MakeSpec) -> None:
    assert list_studies(paths) == []
    for size in (24, 16):
        spec = make_spec(size, n_parallel=2, recipe={"case": "toy"})
        store = open_trials(paths, spec)
        assert store.entry() is None
        store.describe(StudyEntry.of(spec, n_planned=5, created_s=1.7e9))
        store.describe(StudyEntry.of(spec, n_planned=9, created_s=1.8e9))
    entries = list_studies(paths)
    assert [entry.n_train for entry in entries] == [16, 24]
    assert entries[1] == open_trials(paths, make_spec(24, n_parallel=2)).entry()
    assert (entries[0].n_planned, entries[0].created_s) == (9, 1.7e9)
    assert (entries[0].n_parallel, entries[0].recipe, entries[0].note) == (2, {"case": "toy"}, "A toy.")
    assert entries[0].digests == make_spec(16).digests


def test_a_named_lock_is_held_by_one_at_a_time(paths: ProjectPaths) -> None:
    inside, most = 0, 0
    guard = threading.Lock()

    def visit() -> None:
        nonlocal inside, most
        for _ in range(10):
            with named_lock(paths, "mlflow/toy"), named_lock(paths, "another"):
                with guard:
                    inside += 1
                    most = max(most, inside)
                with guard:
                    inside -= 1

    threads = [threading.Thread(target=visit) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (inside, most) == (0, 1)


def test_a_name_that_is_no_study_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'\.\./x/y' is no name of a study; one is like office-quick"):
        open_trials(ProjectPaths(tmp_path), "../x/y")


def test_a_missing_driver_is_one_line_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)  # what an import of an absent package finds
    paths = ProjectPaths(tmp_path, "postgresql://me:secret@nowhere/studies")
    with pytest.raises(InputError, match=r"me:\*\*\*@nowhere.*pip install '\.\[postgres\]'"):
        list_studies(paths)


UNKNOWN = "failed to resolve host 'nowhere': [Errno -2] Name or service not known"
LOOKED_UP_IN_VAIN = "failed to resolve host 'nowhere': [Errno -3] Temporary failure in name resolution"


@pytest.mark.parametrize(
    ("said", "is_ready", "is_away"),
    [(UNKNOWN, False, False), (UNKNOWN, True, True), (LOOKED_UP_IN_VAIN, False, True)],
)
def test_a_host_that_cannot_be_found_any_more_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, said: str, is_ready: bool, is_away: bool
) -> None:
    psycopg = pytest.importorskip("psycopg")

    def fail(*_: object, **__: object) -> None:
        raise psycopg.OperationalError(said)

    monkeypatch.setattr("psycopg.connect", fail)
    server = Database("postgresql://me:secret@nowhere/studies")
    server._is_ready = is_ready
    with pytest.raises(
        InputError, match="does not answer" if is_away else "correct the host of the URL"
    ) as one:
        server.connect()
    assert isinstance(one.value, StorageAwayError) == is_away
