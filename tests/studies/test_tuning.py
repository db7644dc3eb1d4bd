"""A study in this process: repeatable, resumable, extensible; failures and ghosts are dealt with."""

from collections.abc import Callable
from pathlib import Path

import pytest
from optuna.trial import TrialState
from tuning_checks import essence, ignore, in_journal

from pelsvae.config import VARIANTS
from simulation.errors import InputError
from simulation.file_lock import FileLock
from studies.profile import SearchRanges
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.study_store import StudyStore
from studies.tuning.trial_record import read_history, read_records
from studies.tuning.trial_training import report_epochs
from studies.tuning.trial_worker import StudyInterruptedError, run_study

MakeSpec = Callable[..., StudySpec]
N = 8  # trials: one default, some random ones, then the Gaussian process


@pytest.fixture(scope="module")
def uninterrupted(make_spec: MakeSpec, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudySpec]:
    """A study of N trials, run in one go."""
    mlruns = tmp_path_factory.mktemp("uninterrupted")
    spec = make_spec()
    run_study(spec, mlruns=mlruns, n_trials=N, emit=ignore)
    return mlruns, spec


def test_study_leaves_records_and_journal_that_agree(uninterrupted: tuple[Path, StudySpec]) -> None:
    mlruns, spec = uninterrupted
    records = read_records(spec.folder(mlruns))
    trials = in_journal(spec, mlruns)
    assert [r.index for r in records] == list(range(N))
    assert [t.user_attrs["index"] for t in trials] == list(range(N))
    assert [t.params for t in trials] == [r.params for r in records]
    for record, trial in zip(records, trials, strict=True):
        assert trial.state == (TrialState.COMPLETE if record.state == "complete" else TrialState.PRUNED)
        assert {"host", "pid", "process_started_s", "machine"} == set(trial.user_attrs["owner"])
        assert set(read_history(spec.folder(mlruns), record.index)) >= {"epoch", "loss", "validation_mae"}
        if record.state == "complete":
            assert trial.value == record.metrics["val/mae"]
            assert set(record.metrics) == {"val/mae", "val/p90", "test/mae", "test/p90"}


def test_first_trial_is_the_variant_itself(uninterrupted: tuple[Path, StudySpec]) -> None:
    mlruns, spec = uninterrupted
    first = read_records(spec.folder(mlruns))[0]
    assert first.config["learning_rate"] == VARIANTS["refined"].learning_rate
    assert first.config["n_latent"] == 8  # 64 clipped into the range of this search
    assert first.config["n_hidden"] == 32


def test_bad_trials_are_pruned_early(uninterrupted: tuple[Path, StudySpec]) -> None:
    mlruns, spec = uninterrupted
    pruned = [r for r in read_records(spec.folder(mlruns)) if r.state == "pruned"]
    assert pruned
    for record in pruned:
        assert record.n_epochs < 20
        assert "median" in record.reason
        assert set(record.metrics) == {"val/mae"}


def test_only_the_best_trial_keeps_its_weights(uninterrupted: tuple[Path, StudySpec]) -> None:
    mlruns, spec = uninterrupted
    records = [r for r in read_records(spec.folder(mlruns)) if r.state == "complete"]
    best = min(records, key=lambda r: r.metrics["val/mae"])
    kept = list(spec.folder(mlruns).glob("t*/surrogate/weights.npz"))
    assert [file.parent.parent.name for file in kept] == [f"t{best.index:03d}"]


def test_extended_study_equals_one_of_full_length(
    uninterrupted: tuple[Path, StudySpec], tmp_path: Path
) -> None:
    mlruns, spec = uninterrupted
    for n_trials in (3, 6, N):
        run_study(spec, mlruns=tmp_path, n_trials=n_trials, emit=ignore)
        assert len(read_records(spec.folder(tmp_path))) == n_trials
    assert essence(read_records(spec.folder(tmp_path))) == essence(read_records(spec.folder(mlruns)))


@pytest.mark.parametrize("stop_at", [(0, 3), (5, 12), (6, 1)])
def test_interrupted_study_goes_on_as_if_nothing_happened(
    uninterrupted: tuple[Path, StudySpec], tmp_path: Path, stop_at: tuple[int, int]
) -> None:
    mlruns, spec = uninterrupted
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
        run_study(spec, mlruns=tmp_path, n_trials=N, emit=emit, should_stop=stop)
    trials = in_journal(spec, tmp_path)
    assert [t.state for t in trials].count(TrialState.RUNNING) == 0
    assert trials[-1].state == TrialState.FAIL
    assert trials[-1].user_attrs["reason"] == "interrupted"
    run_study(spec, mlruns=tmp_path, n_trials=N, emit=ignore)
    assert essence(read_records(spec.folder(tmp_path))) == essence(read_records(spec.folder(mlruns)))


def test_ghost_of_a_killed_process_is_reaped_and_its_trial_repeated(
    uninterrupted: tuple[Path, StudySpec], tmp_path: Path
) -> None:
    mlruns, spec = uninterrupted
    run_study(spec, mlruns=tmp_path, n_trials=2, emit=ignore)
    lost = read_records(spec.folder(mlruns))[2]
    attributes = {"seed": lost.seed, "config": lost.config, "owner": {"pid": 1}, "started_s": 1.0}
    StudyStore(spec, tmp_path).start(2, params=lost.params, attributes=attributes)
    run_study(spec, mlruns=tmp_path, n_trials=N, emit=ignore)
    states = [t.state for t in in_journal(spec, tmp_path)]
    assert states.count(TrialState.RUNNING) == 0
    assert states.count(TrialState.FAIL) == 1
    assert essence(read_records(spec.folder(tmp_path))) == essence(read_records(spec.folder(mlruns)))


def test_trial_killed_between_its_record_and_the_journal_is_adopted(
    make_spec: MakeSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = make_spec()
    with monkeypatch.context() as patch:
        patch.setattr(StudyStore, "finish", _interrupt)
        patch.setattr(StudyStore, "reap", lambda self, crash="": None)
        with pytest.raises(KeyboardInterrupt):
            run_study(spec, mlruns=tmp_path, n_trials=1, emit=ignore)
    before = read_records(spec.folder(tmp_path))
    assert in_journal(spec, tmp_path)[0].state == TrialState.RUNNING
    run_study(spec, mlruns=tmp_path, n_trials=1, emit=ignore)
    assert read_records(spec.folder(tmp_path)) == before
    assert [t.state for t in in_journal(spec, tmp_path)] == [TrialState.COMPLETE]


def _interrupt(*arguments: object) -> None:
    raise KeyboardInterrupt


def test_half_written_journal_line_is_cut_off(make_spec: MakeSpec, tmp_path: Path) -> None:
    spec = make_spec()
    run_study(spec, mlruns=tmp_path, n_trials=1, emit=ignore)
    with (tmp_path / "optuna.journal").open("ab") as file:
        file.write(b'{"op_code":5,"worker_id":"kill')
    run_study(spec, mlruns=tmp_path, n_trials=2, emit=ignore)
    assert len(in_journal(spec, tmp_path)) == 2


def test_lost_journal_is_rebuilt_from_the_records(
    uninterrupted: tuple[Path, StudySpec], tmp_path: Path
) -> None:
    mlruns, spec = uninterrupted
    run_study(spec, mlruns=tmp_path, n_trials=6, emit=ignore)
    (tmp_path / "optuna.journal").unlink()
    run_study(spec, mlruns=tmp_path, n_trials=N, emit=ignore)
    assert len(in_journal(spec, tmp_path)) == N
    assert essence(read_records(spec.folder(tmp_path))) == essence(read_records(spec.folder(mlruns)))


def test_failed_trial_is_recorded_with_its_reason_and_the_study_goes_on(
    make_spec: MakeSpec, tmp_path: Path
) -> None:
    wild = SearchRanges(n_latent=(2, 8), n_hidden=(8, 32), beta=(1.0, 10.0), learning_rate=(1e-3, 1e38))
    spec = make_spec(search=wild)
    run_study(spec, mlruns=tmp_path, n_trials=5, emit=ignore)
    records = read_records(spec.folder(tmp_path))
    failed = [r for r in records if r.state == "failed"]
    assert len(records) == 5
    assert failed
    assert records[0].state == "complete"
    for record in failed:
        assert record.reason.startswith("TrainingDiverged: ")
        trial = in_journal(spec, tmp_path)[record.index]
        assert trial.state == TrialState.FAIL
        assert trial.user_attrs["result"]["reason"] == record.reason
        assert record.metrics == {}


def test_a_study_is_run_by_one_process_at_a_time(make_spec: MakeSpec, tmp_path: Path) -> None:
    spec = make_spec()
    with (
        FileLock(spec.lock_file(tmp_path)),
        pytest.raises(InputError, match="being tuned by another process"),
    ):
        run_study(spec, mlruns=tmp_path, n_trials=1, emit=ignore)


def test_changed_data_is_refused(make_spec: MakeSpec, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has changed since"):
        run_study(make_spec(train_digest="0" * 64), mlruns=tmp_path, n_trials=1, emit=ignore)


def test_trials_are_compared_at_few_epochs_up_to_the_last() -> None:
    for max_epochs in (1, 7, 20, 1000, 5000):
        epochs = report_epochs(max_epochs)
        assert len(epochs) <= 16
        assert epochs[-1] == max_epochs
        assert epochs == sorted(set(epochs))
