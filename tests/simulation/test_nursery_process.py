"""The process that workers are forked from serves one campaign after the other, each as a new one would."""

import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from simulation.case import load_case
from simulation.errors import MachineError
from simulation.toy import ToyRC
from simulation.workers import nursery_process
from simulation.workers.nursery_process import NurseryProcess, end_resting
from simulation.workers.parallel import ParallelModel

sys.path.insert(0, str(Path(__file__).parent))
from slow_models import SlowToy

ROOT = Path(__file__).parents[2]
ROWS = ToyRC().parameter_space.from_unit(np.random.default_rng(0).random((3, 2)))


@pytest.fixture(autouse=True)
def _nothing_rests(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # On a busy machine workers may take longer to close their model than a campaign waits for them.
    monkeypatch.setattr("simulation.workers.nursery._GRACE_S", 30.0)
    end_resting()
    yield
    end_resting()


def simulate() -> None:
    with ParallelModel(ToyRC, 2) as model:
        assert model.simulate(ROWS).digest == ToyRC().simulate(ROWS).digest


def nurseries() -> list[int]:
    """Return the processes that workers are forked from."""
    children = psutil.Process().children()
    return [c.pid for c in children if "simulation.workers.worker" in " ".join(c.cmdline())]


def test_campaigns_share_it_and_it_alone_waits_for_the_next():
    simulate()
    (pid,) = nurseries()
    assert not psutil.Process(pid).children()
    simulate()
    assert nurseries() == [pid]
    end_resting()
    assert nurseries() == []


def test_two_models_at_once_have_one_each_and_one_rests():
    with ParallelModel(ToyRC, 1) as one:
        one.simulate(ROWS)
        simulate()
        assert len(nurseries()) == 2
    assert len(nurseries()) == 1


def test_many_campaigns_leave_no_descriptor_behind():
    simulate()
    (pid,) = nurseries()
    ours, its = psutil.Process().num_fds(), psutil.Process(pid).num_fds()
    for _ in range(5):
        simulate()
    assert (psutil.Process().num_fds(), psutil.Process(pid).num_fds()) == (ours, its)


def test_each_campaign_begins_paths_and_temporary_files_in_its_own_folders(
    decay_case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    case, rows = load_case(decay_case), np.array([[1e-4, 0.0]])
    settings = replace(case.settings, path=Path("decay.fmu"))
    with case.open_model() as model:
        expected = model.simulate(rows).digest
    pids = set()
    for name in ("first", "second"):
        home, temporary = tmp_path / name, tmp_path / f"{name}-tmp"
        home.mkdir()
        temporary.mkdir()
        (home / "decay.fmu").write_bytes((decay_case / "decay.fmu").read_bytes())
        monkeypatch.chdir(home)
        monkeypatch.setenv("TMPDIR", str(temporary))
        monkeypatch.setattr(tempfile, "tempdir", None)
        with ParallelModel(settings.open, 1) as model:
            assert model.simulate(rows).digest == expected
            assert list(temporary.iterdir())
        assert not list(temporary.iterdir())
        pids.update(nurseries())
        # Whoever had begun in the first folder could not open it there again.
        (home / "decay.fmu").unlink()
    assert len(pids) == 1


def _another_variable(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")


def _another_module_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))


def _another_umask(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    os.umask(0o027)


def _fewer_cores(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])


@pytest.mark.parametrize("change", [_another_variable, _another_module_path, _another_umask, _fewer_cores])
def test_what_a_process_is_given_at_its_start_starts_another(
    change: Callable[[pytest.MonkeyPatch, Path], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    umask, cores = os.umask(0o022), os.sched_getaffinity(0)
    if change is _fewer_cores and len(cores) == 1:
        pytest.skip("this process may use one core")
    try:
        simulate()
        (first,) = nurseries()
        change(monkeypatch, tmp_path)
        simulate()
        assert len(nurseries()) == 1
        assert first not in nurseries()
    finally:
        os.umask(umask)
        os.sched_setaffinity(0, cores)


def test_code_of_the_user_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    model_file = tmp_path / "model_of_the_user.py"
    # Of another size: Python takes a file of the same second and size for the same file.
    for ambient in (10.0, 120.0):
        text = f"from simulation.toy import ToyRC\ndef opened():\n    return ToyRC(ambient={ambient})\n"
        model_file.write_text(text)
        sys.modules.pop("model_of_the_user", None)
        from model_of_the_user import opened  # type: ignore[import-not-found]

        with ParallelModel(opened, 1) as model:
            assert model.simulate(ROWS).y[0, 0, 0] == ambient
        assert nurseries() == []


def test_one_that_was_killed_while_it_rested_is_replaced():
    simulate()
    (pid,) = nurseries()
    os.kill(pid, signal.SIGKILL)
    psutil.wait_procs([psutil.Process(pid)], timeout=5)
    simulate()
    assert pid not in nurseries()


def test_it_ends_when_nobody_comes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(nursery_process, "_PATIENCE_S", 0.3)
    simulate()
    (pid,) = nurseries()
    assert psutil.Process(pid).wait(timeout=10) == 0
    simulate()
    assert pid not in nurseries()


def test_a_fork_of_the_program_holds_nothing_up():
    """It has the connections too, so that closing them here tells nobody."""
    simulate()
    fork = multiprocessing.get_context("fork").Process(target=time.sleep, args=(30.0,), daemon=True)
    fork.start()
    started = time.monotonic()
    with ParallelModel(ToyRC, 1) as other:
        other.simulate(ROWS)
        simulate()
    end_resting()
    assert nurseries() == []
    assert time.monotonic() - started < 40
    fork.terminate()
    fork.join()


def test_no_room_for_temporary_files_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # Full for the process that workers are forked from, which makes a folder in it.
    (tmp_path / "sitecustomize.py").write_text(
        "import errno, os, tempfile\n"
        "def full(**_):\n"
        "    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))\n"
        "tempfile.mkdtemp = full\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    with (
        pytest.raises(MachineError, match=r"no temporary folder .*No space left on device.*TMPDIR"),
        ParallelModel(ToyRC, 1) as model,
    ):
        model.simulate(ROWS)
    assert nurseries() == []


NO_ROOM = """
import errno, os, pathlib
def limited(call):
    n_calls = []
    def limited_call(*arguments, **options):
        n_calls.append(call)
        if len(n_calls) > {n}:
            raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return call(*arguments, **options)
    return limited_call
"""


@pytest.mark.parametrize("call", ["os.fork", "pathlib.Path.mkdir"])
def test_where_one_process_can_be_started_it_goes_on(
    call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "sitecustomize.py").write_text(f"{NO_ROOM.format(n=1)}{call} = limited({call})\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    rows, warnings = np.tile(ROWS, (20, 1)), []
    with ParallelModel(SlowToy(row_s=0.02).open, 3, on_warning=warnings.append) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest
        (pid,) = nurseries()
        assert len(psutil.Process(pid).children()) == 1
    assert len(warnings) == 1
    assert "only 1 of 3 processes" in warnings[0]
    assert "(Resource temporarily unavailable); lower simulation.max_workers" in warnings[0]


def test_where_none_can_be_started_the_machine_is_in_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "sitecustomize.py").write_text(f"{NO_ROOM.format(n=0)}os.fork = limited(os.fork)\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    with (
        pytest.raises(
            MachineError, match=r"^a process .*started \(Resource temporarily unavailable\); free memory"
        ),
        ParallelModel(ToyRC, 1) as model,
    ):
        model.simulate(ROWS)


@pytest.mark.parametrize("when", ["before", "after"])
def test_ctrl_c_while_it_comes_to_rest_harms_nobody(when: str, monkeypatch: pytest.MonkeyPatch):
    rest, here = NurseryProcess.rest, threading.main_thread().ident
    assert here is not None

    def interrupted(process: NurseryProcess) -> bool:
        if when == "before":
            signal.pthread_kill(here, signal.SIGINT)
        has_rested = rest(process)
        signal.pthread_kill(here, signal.SIGINT)
        return has_rested

    with ParallelModel(ToyRC, 1) as model:
        model.simulate(ROWS)
        monkeypatch.setattr(NurseryProcess, "rest", interrupted)
        with pytest.raises(KeyboardInterrupt):
            model.close()
        monkeypatch.setattr(NurseryProcess, "rest", rest)
        simulate()
        assert model.simulate(ROWS).digest == ToyRC().simulate(ROWS).digest
    assert len(nurseries()) == 1


FORKING = """
import os, sys
sys.path[:0] = [{tests!r}, {root!r}]
from simulation.workers import nursery
from test_nursery_process import nurseries, simulate
nursery._GRACE_S = 30.0
simulate()
(pid,) = nurseries()
if (child := os.fork()) == 0:
    simulate()
    os._exit(0 if len(nurseries()) == 1 else 1)
assert os.waitpid(child, 0)[1] == 0
simulate()
assert nurseries() == [pid]
print(pid)
"""


def test_a_fork_has_its_own_and_none_outlives_its_program():
    script = FORKING.format(tests=str(Path(__file__).parent), root=str(ROOT))
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not psutil.pid_exists(int(done.stdout))
    assert done.stderr == ""
