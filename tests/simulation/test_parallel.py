"""Rows over processes: the same bits, started only when it pays, and gone when the parent is."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from simulation.case import load_case
from simulation.parallel import ParallelModel, available_cores
from simulation.toy import ToyRC

# Workers import the models by name, from this folder.
sys.path.insert(0, str(Path(__file__).parent))
from slow_models import DeadlyToy, SlowToy

ROOT = Path(__file__).parents[2]


def _rows(n: int) -> np.ndarray:
    return ToyRC().parameter_space.from_unit(np.random.default_rng(0).random((n, 2)))


def test_serial_equals_parallel_bit_for_bit(decay_case: Path):
    case = load_case(decay_case)
    rows = np.column_stack([np.geomspace(2e-5, 5e-4, 101), np.arange(101) % 5])
    with case.open_model() as serial, ParallelModel(case.make_model, 2, pool_pays_s=0.0) as parallel:
        first = parallel.simulate(rows)
        assert parallel.pool_started
        assert first.digest == serial.simulate(rows).digest
        assert parallel.simulate(rows).digest == first.digest


def test_a_cheap_batch_starts_no_workers():
    with ParallelModel(ToyRC) as model:
        for _ in range(5):
            model.simulate(_rows(500))
        assert not model.pool_started


def test_an_expensive_batch_starts_workers():
    with ParallelModel(SlowToy, 2, pool_pays_s=0.5) as model:
        model.simulate(_rows(3))
        assert not model.pool_started
        model.simulate(_rows(16))
        assert model.pool_started


def test_a_row_that_kills_its_process_is_a_failed_row():
    rows = _rows(24)
    rows[:9, 0] = 1.0  # those simulated in this process must not kill it
    deadly = rows[:, 0] > 4.0
    assert deadly.any()
    with ParallelModel(DeadlyToy, 2, pool_pays_s=0.0) as model:
        answer = model.simulate(rows)
    assert np.array_equal(answer.failed, deadly)
    assert set(np.array(answer.failures)[deadly]) == {"the process that simulated this row died"}
    good = ToyRC().simulate(rows)
    assert answer.take(~deadly).digest == good.take(~deadly).digest


def test_the_cores_are_those_this_process_may_use():
    assert ParallelModel(ToyRC).n_workers == available_cores()
    if hasattr(os, "sched_getaffinity"):
        assert available_cores() == len(os.sched_getaffinity(0))


def test_no_worker_is_no_choice():
    with pytest.raises(ValueError, match="n_workers is 0"):
        ParallelModel(ToyRC, 0)


SCRIPT = """
import sys
sys.path[:0] = [{tests!r}, {root!r}]
import numpy as np
from simulation.parallel import ParallelModel
from slow_models import SlowToy

if __name__ == "__main__":
    rows = SlowToy().parameter_space.from_unit(np.random.default_rng(0).random((4000, 2)))
    with ParallelModel(SlowToy, 2, pool_pays_s=0.0) as model:
        model.simulate(rows[:9])
        model.simulate(rows[:20])
        print("ready", flush=True)
        model.simulate(rows)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_no_worker_outlives_its_parent(how: signal.Signals, tmp_path: Path):
    script = tmp_path / "work.py"
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent), root=str(ROOT)))
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2
        time.sleep(0.1)
        started = time.monotonic()
        process.send_signal(how)
        process.wait(timeout=20)
        _, alive = psutil.wait_procs(workers, timeout=10)
        assert not alive
        # The batch would have taken 100 s.
        assert time.monotonic() - started < 10


def test_a_script_without_a_guard_is_told_so(tmp_path: Path):
    script = tmp_path / "unguarded.py"
    script.write_text(
        SCRIPT.format(tests=str(Path(__file__).parent), root=str(ROOT)).replace(
            '__name__ == "__main__"', "True"
        )
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode != 0
    assert 'start its work under if __name__ == "__main__"' in done.stderr
