"""Studies in worker processes: the same trials however many workers, however often killed."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from tuning_checks import essence, in_optuna, records_of

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.search_ranges import SearchRanges
from studies.tracking.tracker import NullTracker
from studies.tuning.crew import Crew, TuningError
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.trial_store import open_trials
from studies.tuning.tune import tune


class Deadly(SearchRanges):
    """Search ranges that end the process that reads them."""

    def __reduce__(self) -> tuple[Callable[[int], None], tuple[int]]:
        return os._exit, (9,)


MakeSpec = Callable[..., StudySpec]
N = 7
ROOT = Path(__file__).resolve().parent.parent.parent
PARENT = """
import pickle, sys
from pathlib import Path
from studies.paths import ProjectPaths
from studies.tuning.tune import tune

if __name__ == "__main__":
    specs = pickle.loads(Path(sys.argv[1]).read_bytes())
    tune(specs, paths=ProjectPaths(Path(sys.argv[2])), n_trials=7, n_jobs=2,
         on_event=lambda event: print(event.kind, event.n_train, event.index, flush=True))
"""


@pytest.fixture(scope="module")
def specs(make_spec: MakeSpec) -> list[StudySpec]:
    return [make_spec(16), make_spec(24)]


@pytest.fixture(scope="module")
def undisturbed(
    specs: list[StudySpec], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[tuple[object, ...]]]:
    """What the trials of both studies are when one worker runs them in one go."""
    paths = ProjectPaths(tmp_path_factory.mktemp("undisturbed"))
    heard: list[TuneEvent] = []
    summaries = tune(specs, paths=paths, n_trials=N, n_jobs=1, on_event=heard.append)
    assert [summary.n_train for summary in summaries] == [16, 24]
    assert [summary.n_trials for summary in summaries] == [N, N]
    assert [event.n_train for event in heard if event.kind == "study-finished"] == [24, 16]
    assert sum(event.kind == "trial-finished" for event in heard) == 2 * N
    again: list[TuneEvent] = []
    assert tune(specs, paths=paths, n_trials=N, on_event=again.append) == summaries
    assert again == []
    return {spec.name: essence(records_of(spec, paths)) for spec in specs}


@pytest.fixture
def start(specs: list[StudySpec], tmp_path: Path) -> Iterator[Callable[[], subprocess.Popen[str]]]:
    """Start a command that tunes both studies with two workers, as a user's shell would."""
    script, given = tmp_path / "parent.py", tmp_path / "specs.pickle"
    script.write_text(PARENT)
    given.write_bytes(pickle.dumps(specs))
    command = [sys.executable, str(script), str(given), str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipe = subprocess.PIPE
    started: list[subprocess.Popen[str]] = []

    def start() -> subprocess.Popen[str]:
        started.append(
            subprocess.Popen(
                command, stdout=pipe, stderr=pipe, text=True, env=environment, start_new_session=True
            )
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def wait_for_trial(process: subprocess.Popen[str], index: int, *, n_studies: int) -> None:
    """Read the command's output until so many studies have begun a trial of this index or a later one."""
    assert process.stdout is not None
    arrived = set()
    for line in process.stdout:
        kind, study, trial = line.split()
        if kind == "trial-started" and int(trial) >= index:
            arrived.add(study)
        if len(arrived) == n_studies:
            return
    raise AssertionError(f"the command ended early: {process.stderr and process.stderr.read()}")


def wait_for_end(processes: list[psutil.Process]) -> None:
    _, alive = psutil.wait_procs(processes, timeout=10)
    assert not alive


def test_interrupted_and_killed_commands_lose_and_repeat_nothing(
    specs: list[StudySpec],
    start: Callable[[], subprocess.Popen[str]],
    tmp_path: Path,
    undisturbed: dict[str, list[tuple[object, ...]]],
) -> None:
    paths = ProjectPaths(tmp_path)

    interrupted = start()
    wait_for_trial(interrupted, 2, n_studies=1)
    workers = psutil.Process(interrupted.pid).children(recursive=True)
    os.killpg(interrupted.pid, signal.SIGINT)  # as a terminal does: the whole group
    _, errors = interrupted.communicate(timeout=30)
    assert interrupted.returncode != 0
    assert errors.strip().endswith("KeyboardInterrupt")
    wait_for_end(workers)
    for spec in specs:
        assert not [t for t in in_optuna(spec, paths) if not t.state.is_finished()]

    killed = start()
    wait_for_trial(killed, 3, n_studies=2)
    workers = psutil.Process(killed.pid).children(recursive=True)
    killed.send_signal(signal.SIGKILL)
    wait_for_end(workers)
    finished = {spec.name: records_of(spec, paths) for spec in specs}
    assert all(finished.values())

    tune(specs, paths=paths, n_trials=N, n_jobs=2)
    for spec in specs:
        assert essence(records_of(spec, paths)) == undisturbed[spec.name]
        assert (
            records_of(spec, paths)[: len(finished[spec.name])] == finished[spec.name]
        )  # none was run again
        assert not [t for t in in_optuna(spec, paths) if not t.state.is_finished()]
        assert (paths.champion(spec.label, spec.n_train) / "champion.json").is_file()


def test_worker_killed_once_is_replaced_and_killed_twice_is_a_failed_trial(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    spec = make_spec(16)
    crew = Crew(paths=project, n_trials=4, n_workers=1)
    n_kills = 0
    for _, event in crew.run([spec]):
        if event.kind == "trial-started" and event.index == 1 and n_kills < 2:
            n_kills += 1
            os.kill(crew.pids[0], signal.SIGKILL)
    records = records_of(spec, project)
    assert n_kills == 2
    assert [record.state == "failed" for record in records] == [False, True, False, False]
    assert records[1].reason == "its process ended twice (exit code -9)"
    assert open_trials(project, spec).claims() == []


def test_a_worker_that_never_comes_to_a_trial_ends_the_command(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    """Its search ranges cannot be unpickled without ending the process, as a missing library might."""
    spec = make_spec(16, search=Deadly())
    with pytest.raises(TuningError, match=r"3 times in a row before a trial began \(exit code 9\)"):
        tune([spec], paths=project, n_trials=1, n_jobs=1)


def test_a_trial_that_failed_with_its_process_is_tracked(
    make_spec: MakeSpec, project: ProjectPaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = NullTracker()
    told: set[int] = set()
    monkeypatch.setattr(tracker, "log_trial", lambda spec, record, history: told.add(record.index))
    n_kills = 0

    def kill(event: TuneEvent) -> None:
        nonlocal n_kills
        if event.kind == "trial-started" and event.index == 0 and n_kills < 2:
            n_kills += 1
            (worker,) = (
                child
                for child in psutil.Process().children()
                if child.status() != psutil.STATUS_ZOMBIE and "spawn_main" in " ".join(child.cmdline())
            )
            worker.kill()

    (summary,) = tune([make_spec(16)], paths=project, n_trials=2, n_jobs=1, tracker=tracker, on_event=kill)
    assert (summary.n_failed, summary.n_trials) == (1, 2)
    assert told == {0, 1}


def test_input_error_of_a_worker_is_one_line_here(make_spec: MakeSpec, project: ProjectPaths) -> None:
    with pytest.raises(InputError, match="has changed since") as caught:
        tune([make_spec(train_digest="0" * 64)], paths=project, n_trials=1, n_jobs=1)
    assert "\n" not in str(caught.value)


def test_a_damaged_journal_is_one_line_leaves_no_worker_and_can_be_moved_away(
    specs: list[StudySpec], project: ProjectPaths
) -> None:
    tune(specs, paths=project, n_trials=1, n_jobs=2)
    before = [records_of(spec, project) for spec in specs]
    journal = project.mlruns / "optuna.journal"
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join([lines[0], "garbage", *lines[1:]]) + "\n")
    with pytest.raises(InputError, match=r"optuna\.journal is damaged .* move it away"):
        tune(specs, paths=project, n_trials=2, n_jobs=2)
    assert not [child for child in multiprocessing.active_children() if child.name.startswith("tune-")]
    journal.unlink()
    tune(specs, paths=project, n_trials=2, n_jobs=2)
    for spec, kept in zip(specs, before, strict=True):
        assert records_of(spec, project)[:1] == kept
        assert len(in_optuna(spec, project)) == 2
