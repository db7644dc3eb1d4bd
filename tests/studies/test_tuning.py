"""A study in this process: repeatable, resumable, extensible; failures and ghosts are dealt with."""

import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import optuna
import pytest
from optuna.trial import TrialState, create_trial
from tuning_checks import essence, ignore, in_optuna, records_of, run_and_tell

from pelsvae import process_fitting
from pelsvae.config import VARIANTS
from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.search_ranges import SearchRanges
from studies.tuning.claim import Claim, this_owner
from studies.tuning.outage import StudyInterruptedError
from studies.tuning.slots import MAX_LOST
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.study_store import open_optuna
from studies.tuning.trial_record import read_history
from studies.tuning.trial_store import open_trials
from studies.tuning.trial_training import report_epochs
from studies.tuning.trial_worker import Worker, run_study

MakeSpec = Callable[..., StudySpec]
N = 8  # trials: one default, some random ones, then the Gaussian process


@pytest.fixture(scope="module")
def uninterrupted(
    make_spec: MakeSpec, tmp_path_factory: pytest.TempPathFactory
) -> tuple[ProjectPaths, StudySpec]:
    """A study of N trials, run in one go."""
    paths = ProjectPaths(tmp_path_factory.mktemp("uninterrupted"))
    spec = make_spec()
    run_and_tell(spec, paths, N)
    return paths, spec


def test_study_leaves_records_and_journal_that_agree(uninterrupted: tuple[ProjectPaths, StudySpec]) -> None:
    paths, spec = uninterrupted
    records = records_of(spec, paths)
    trials = in_optuna(spec, paths)
    assert [r.index for r in records] == list(range(N))
    assert [t.user_attrs["index"] for t in trials] == list(range(N))
    assert [t.params for t in trials] == [r.params for r in records]
    for record, trial in zip(records, trials, strict=True):
        assert trial.state == (TrialState.COMPLETE if record.state == "complete" else TrialState.PRUNED)
        assert {"host", "pid", "process_started_s", "machine", "worker"} == set(
            trial.user_attrs["result"]["owner"]
        )
        assert set(read_history(spec.folder(paths.mlruns), record.index)) >= {
            "epoch",
            "loss",
            "validation_mae",
        }
        if record.state == "complete":
            assert trial.value == record.metrics["val/mae"]
            assert set(record.metrics) == {"val/mae", "val/p90", "test/mae", "test/p90"}


def test_first_trial_is_the_variant_itself(uninterrupted: tuple[ProjectPaths, StudySpec]) -> None:
    paths, spec = uninterrupted
    first = records_of(spec, paths)[0]
    assert first.config["learning_rate"] == VARIANTS["refined"].learning_rate
    assert first.config["n_latent"] == 8  # 64 clipped into the range of this search
    assert first.config["n_hidden"] == 32


def test_bad_trials_are_pruned_early(uninterrupted: tuple[ProjectPaths, StudySpec]) -> None:
    paths, spec = uninterrupted
    pruned = [r for r in records_of(spec, paths) if r.state == "pruned"]
    assert pruned
    for record in pruned:
        assert record.n_epochs < 20
        assert "could not catch up" in record.reason
        assert set(record.metrics) == {"val/mae"}


def test_only_the_best_trial_keeps_its_weights(uninterrupted: tuple[ProjectPaths, StudySpec]) -> None:
    paths, spec = uninterrupted
    records = [r for r in records_of(spec, paths) if r.state == "complete"]
    best = min(records, key=lambda r: r.metrics["val/mae"])
    kept = list(spec.folder(paths.mlruns).glob("t*/surrogate/weights.npz"))
    assert [file.parent.parent.name for file in kept] == [f"t{best.index:03d}"]


def test_extended_study_equals_one_of_full_length(
    uninterrupted: tuple[ProjectPaths, StudySpec], project: ProjectPaths
) -> None:
    paths, spec = uninterrupted
    for n_trials in (3, 6, N):
        run_and_tell(spec, project, n_trials)
        assert len(records_of(spec, project)) == n_trials
    assert essence(records_of(spec, project)) == essence(records_of(spec, paths))


@pytest.mark.parametrize("stop_at", [(0, 3), (5, 12), (6, 1)])
def test_interrupted_study_goes_on_as_if_nothing_happened(
    uninterrupted: tuple[ProjectPaths, StudySpec], project: ProjectPaths, stop_at: tuple[int, int]
) -> None:
    paths, spec = uninterrupted
    n_asked = 0
    index = 0

    def emit(event: TuneEvent) -> None:
        nonlocal index, n_asked
        if event.kind == "trial-started":
            index, n_asked = event.index, 0

    def stop() -> bool:
        nonlocal n_asked
        n_asked += 1
        return (index, n_asked) == stop_at

    with pytest.raises(StudyInterruptedError):
        run_and_tell(spec, project, N, emit=emit, should_stop=stop)
    store = open_trials(project, spec)
    assert store.running() == []
    assert [claim.index for claim, _ in store.claims()] == [stop_at[0]]
    run_and_tell(spec, project, N)
    assert essence(records_of(spec, project)) == essence(records_of(spec, paths))
    assert [r.attempts for r in records_of(spec, project)] == [1 + (i == stop_at[0]) for i in range(N)]
    assert [t.user_attrs["index"] for t in in_optuna(spec, project)] == list(range(N))
    assert store.claims() == []


def lost_claim(spec: StudySpec, paths: ProjectPaths, index: int) -> Claim:
    """Make the claim that a process left when it was killed."""
    lost = records_of(spec, paths)[index]
    claim = Claim(
        index=index,
        params=lost.params,
        config=lost.config,
        seed=lost.seed,
        origin=lost.origin,
        started_s=1.0,
        max_epochs=20,
    )
    return claim.taken({**this_owner(), "pid": 2**22 + 1}, 1.0)


def test_trial_of_a_killed_process_is_found_and_repeated(
    uninterrupted: tuple[ProjectPaths, StudySpec], project: ProjectPaths
) -> None:
    paths, spec = uninterrupted
    run_and_tell(spec, project, 2)
    open_trials(project, spec).put_claim(lost_claim(spec, paths, 2))
    run_and_tell(spec, project, N)
    assert essence(records_of(spec, project)) == essence(records_of(spec, paths))
    assert [r.attempts for r in records_of(spec, project)][:4] == [1, 1, 2, 1]


def test_trial_whose_machine_dies_again_and_again_is_recorded_as_failed(
    uninterrupted: tuple[ProjectPaths, StudySpec], project: ProjectPaths
) -> None:
    paths, spec = uninterrupted
    run_and_tell(spec, project, 2)
    claim = replace(lost_claim(spec, paths, 2), n_lost=MAX_LOST - 1, attempt=MAX_LOST)
    open_trials(project, spec).put_claim(claim)
    run_and_tell(spec, project, 4)
    records = records_of(spec, project)
    assert [r.state == "failed" for r in records] == [False, False, True, False]
    assert records[2].reason == f"its command or machine died {MAX_LOST} times"
    assert records[2].params == claim.params
    assert in_optuna(spec, project)[2].state == TrialState.FAIL


def test_trial_killed_between_its_record_and_optuna_is_adopted(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    spec = make_spec()
    run_study(spec, paths=project, n_trials=2, emit=ignore)
    before = records_of(spec, project)
    run_and_tell(spec, project, 2)
    assert records_of(spec, project) == before
    trials = in_optuna(spec, project)
    assert [t.user_attrs["index"] for t in trials] == [0, 1]
    assert [t.datetime_start and t.datetime_start.timestamp() for t in trials] == [
        pytest.approx(record.started_s, abs=1e-5) for record in before
    ]


def test_foreign_and_double_trials_in_optuna_are_cleared_away(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    spec = make_spec()
    run_and_tell(spec, project, 2)
    study = optuna.load_study(study_name=spec.name, storage=open_optuna(project))
    study.add_trial(create_trial(state=TrialState.RUNNING))
    study.add_trial(study.trials[0])
    run_and_tell(spec, project, 3)
    assert [t.user_attrs["index"] for t in in_optuna(spec, project)] == [0, 1, 2]


def test_a_worker_trains_on_its_threads_and_finds_the_same(
    make_spec: MakeSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_fitting, "THREADED_ROWS", 1)
    spec = make_spec(variant="gaussian-process", search=SearchRanges())
    found, most = {}, {}
    for n_jobs in (1, 3):
        (tmp_path / str(n_jobs) / "fmus").mkdir(parents=True)
        project, seen = ProjectPaths(tmp_path / str(n_jobs)), [0]

        def note(event: TuneEvent, seen: list[int] = seen) -> None:
            # Those that compute; searches that go in step have threads that wait.
            seen.append(sum(one.name.startswith("ThreadPool") for one in threading.enumerate()))

        Worker([spec], paths=project, n_trials=1, emit=note, n_jobs=n_jobs).run()
        found[n_jobs] = [record.metrics for record in records_of(spec, project)]
        most[n_jobs] = max(seen)
    assert most[3] == most[1] + 3
    assert found[3] == found[1] != []


@pytest.mark.parametrize("max_s", [0.0, 0.8])
def test_time_limit_begins_no_trial_and_ends_none(
    make_spec: MakeSpec, project: ProjectPaths, max_s: float
) -> None:
    spec = make_spec()
    heard: list[TuneEvent] = []
    Worker([spec], paths=project, n_trials=1000, emit=heard.append, deadline_s=time.time() + max_s).run()
    records = records_of(spec, project)
    assert len(records) < 1000
    assert bool(records) == bool(max_s)
    assert open_trials(project, spec).claims() == []
    assert "study-finished" not in {event.kind for event in heard}


def test_trial_that_takes_too_long_is_pruned_with_that_reason(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    spec = make_spec(max_trial_s=1e-9)
    assert spec.digest == make_spec().digest
    run_and_tell(spec, project, 2)
    for record, trial in zip(records_of(spec, project), in_optuna(spec, project), strict=True):
        assert (record.state, record.n_epochs) == ("pruned", 1)
        assert record.reason == "reached its limit of 1e-09 s at epoch 1"
        assert trial.value == record.metrics["val/mae"]


def test_trial_without_enough_memory_fails_with_that_reason(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    huge = SearchRanges(n_latent=(2, 8), n_hidden=(2**19, 2**19), beta=(1.0, 10.0))
    spec = make_spec(search=huge)
    run_and_tell(spec, project, 1)
    (record,) = records_of(spec, project)
    assert record.state == "failed"
    assert record.reason.startswith("out of memory (")
    assert "\n" not in record.reason


def test_half_written_journal_line_is_cut_off(make_spec: MakeSpec, project: ProjectPaths) -> None:
    spec = make_spec()
    run_and_tell(spec, project, 1)
    with (project.mlruns / "optuna.journal").open("ab") as file:
        file.write(b'{"op_code":5,"worker_id":"kill')
    run_and_tell(spec, project, 2)
    assert len(in_optuna(spec, project)) == 2


def test_lost_journal_is_rebuilt_from_the_records(
    uninterrupted: tuple[ProjectPaths, StudySpec], project: ProjectPaths
) -> None:
    paths, spec = uninterrupted
    run_and_tell(spec, project, 6)
    (project.mlruns / "optuna.journal").unlink()
    run_and_tell(spec, project, N)
    assert len(in_optuna(spec, project)) == N
    assert essence(records_of(spec, project)) == essence(records_of(spec, paths))


def test_failed_trial_is_recorded_with_its_reason_and_the_study_goes_on(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    wild = SearchRanges(n_latent=(2, 8), n_hidden=(8, 32), beta=(1.0, 10.0), learning_rate=(1e-3, 1e38))
    spec = make_spec(search=wild)
    run_and_tell(spec, project, 5)
    records = records_of(spec, project)
    failed = [r for r in records if r.state == "failed"]
    assert len(records) == 5
    assert failed
    assert records[0].state == "complete"
    for record in failed:
        assert record.reason.startswith("TrainingDiverged: ")
        trial = in_optuna(spec, project)[record.index]
        assert trial.state == TrialState.FAIL
        assert trial.user_attrs["result"]["reason"] == record.reason
        assert record.metrics == {}


def test_changed_data_is_refused(make_spec: MakeSpec, project: ProjectPaths) -> None:
    with pytest.raises(InputError, match="has changed since"):
        run_study(make_spec(train_digest="0" * 64), paths=project, n_trials=1, emit=ignore)


def test_trials_are_compared_at_few_epochs_up_to_the_last() -> None:
    for max_epochs in (1, 7, 20, 1000, 5000):
        epochs = report_epochs(max_epochs)
        assert len(epochs) <= 16
        assert epochs[-1] == max_epochs
        assert epochs == sorted(set(epochs))


def test_a_full_disk_is_waited_for(uninterrupted: tuple[ProjectPaths, StudySpec], tmp_path: Path) -> None:
    """The disk is a real one of a few hundred kilobytes, where this process may mount one."""
    paths, spec = uninterrupted
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no disk of its own can be mounted here")
    heard: list[str] = []
    ballast = disk / "ballast"

    def emit(event: TuneEvent) -> None:
        if event.kind == "trial-started" and event.index == 1:
            with suppress(OSError), ballast.open("wb", buffering=0) as file:
                while file.write(b"x" * 4096):
                    pass
        elif event.kind == "waiting":
            heard.append(event.message)
            ballast.unlink(missing_ok=True)

    try:
        run_study(spec, paths=ProjectPaths(disk), n_trials=3, emit=emit)
        assert essence(records_of(spec, ProjectPaths(disk))) == essence(records_of(spec, paths)[:3])
    finally:
        subprocess.run(["umount", str(disk)], check=True)
    assert [bool(line) for line in heard] == [True, False]
    assert "No space left on device" in heard[0]
    assert heard[0].endswith("free some space")
