"""The process that workers are forked from serves one campaign after the other, each as a new one would."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from simulation.toy import ToyRC
from simulation.workers.nursery_process import end_resting
from simulation.workers.parallel import ParallelModel

sys.path.insert(0, str(Path(__file__).parent))
from slow_models import CrashingToy, DyingAtOpeningToy, SlowToy, SurroundedToy

ROOT = Path(__file__).parents[2]
ROWS = ToyRC().parameter_space.from_unit(np.random.default_rng(0).random((3, 2)))


@pytest.fixture(autouse=True)
def _nothing_rests() -> Iterator[None]:
    end_resting()
    yield
    end_resting()


def simulate(toy: SlowToy | None = None) -> None:
    toy = toy or SlowToy(row_s=0.0)
    with ParallelModel(toy.open, 2) as model:
        assert model.simulate(ROWS).digest == ToyRC().simulate(ROWS).digest


def nurseries() -> list[int]:
    """Return the processes that workers are forked from."""
    children = psutil.Process().children()
    return [c.pid for c in children if "simulation.workers.worker" in " ".join(c.cmdline())]


def test_campaigns_share_it_and_it_alone_waits_for_the_next():
    simulate()
    (pid,) = nurseries()
    assert not psutil.Process(pid).children()
    simulate(SlowToy(row_s=0.01))
    assert nurseries() == [pid]
    end_resting()
    assert nurseries() == []


def test_two_models_at_once_have_one_each_and_one_rests():
    with ParallelModel(SlowToy(row_s=0.0).open, 1) as one:
        one.simulate(ROWS)
        simulate()
        assert len(nurseries()) == 2
    assert len(nurseries()) == 1


def test_workers_see_the_surroundings_of_their_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Variables, the folder that paths begin in, and the one for temporary files; none of an earlier one."""
    pids = set()
    for name in ("first", "second"):
        home, temporary, seen = tmp_path / name, tmp_path / f"{name}-tmp", tmp_path / f"{name}.txt"
        home.mkdir()
        temporary.mkdir()
        with monkeypatch.context() as here:
            here.setenv(f"ONLY_{name}", name)
            here.setenv("TMPDIR", str(temporary))
            here.setattr("tempfile.tempdir", None)
            here.chdir(home)
            simulate(SurroundedToy(row_s=0.0, seen=seen))
        opened_in, scratch, *variables = seen.read_text().splitlines()
        assert opened_in == str(home)
        assert scratch.startswith(str(temporary))
        assert variables == [f"ONLY_{name}"]
        assert not list(temporary.iterdir())
        pids.update(nurseries())
    assert len(pids) == 1


def test_what_is_read_at_the_start_of_a_process_starts_another(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    simulate()
    (first,) = nurseries()
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    simulate()
    (second,) = nurseries()
    assert second != first
    monkeypatch.syspath_prepend(str(tmp_path))
    simulate()
    assert second not in nurseries()


def test_one_that_was_killed_while_it_rested_is_replaced():
    simulate()
    (pid,) = nurseries()
    os.kill(pid, signal.SIGKILL)
    psutil.wait_procs([psutil.Process(pid)], timeout=5)
    simulate()
    assert pid not in nurseries()


def test_it_ends_when_nobody_comes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    (tmp_path / "sitecustomize.py").write_text(
        "import simulation.workers.worker\nsimulation.workers.worker._PATIENCE_S = 0.3\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    simulate()
    (pid,) = nurseries()
    assert psutil.Process(pid).wait(timeout=10) == 0
    simulate()
    assert pid not in nurseries()


def test_crashes_of_one_campaign_are_not_the_next_one_s():
    bad = ROWS.copy()
    bad[1, 0] = 4.5
    with ParallelModel(CrashingToy().open, 1) as model:
        assert model.simulate(bad).failed.tolist() == [False, True, False]
    assert len(nurseries()) == 1
    with (
        pytest.raises(Exception, match="crashed its process"),
        ParallelModel(DyingAtOpeningToy().open, 1) as model,
    ):
        model.simulate(ROWS)
    assert nurseries() == []
    simulate()
    assert len(nurseries()) == 1


def test_ctrl_c_while_it_comes_to_rest_leaves_none(monkeypatch: pytest.MonkeyPatch):
    from simulation.workers import nursery_process

    rest, here = nursery_process.NurseryProcess.rest, threading.main_thread().ident
    assert here is not None

    def interrupted(process: nursery_process.NurseryProcess) -> bool:
        signal.pthread_kill(here, signal.SIGINT)
        return rest(process)

    monkeypatch.setattr(nursery_process.NurseryProcess, "rest", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simulate()
    assert nurseries() == []


FORKING = """
import os, sys
sys.path[:0] = [{tests!r}, {root!r}]
from test_nursery_process import nurseries, simulate
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
