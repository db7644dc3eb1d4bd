"""Rows over worker processes: the same bits, few processes for little work, and none when all is done."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from simulation.case import load_case
from simulation.errors import InputError
from simulation.toy import ToyRC
from simulation.workers.execution import ExecutionPolicy
from simulation.workers.nursery_process import end_resting
from simulation.workers.parallel import ParallelModel, available_cores

# Workers import the models by name, from this folder.
sys.path.insert(0, str(Path(__file__).parent))
from slow_models import PickyToy, SlowToy, WarmingToy

ROOT = Path(__file__).parents[2]


def _rows(n: int) -> np.ndarray:
    return ToyRC().parameter_space.from_unit(np.random.default_rng(0).random((n, 2)))


def test_serial_equals_parallel_bit_for_bit(decay_case: Path):
    case = load_case(decay_case)
    rows = np.column_stack([np.geomspace(2e-5, 5e-4, 101), np.array([0, 1, 2, 4, 5])[np.arange(101) % 5]])
    policy = ExecutionPolicy(max_failed_share=1.0)
    with case.open_model() as serial, ParallelModel(case.make_model, 2, policy=policy) as parallel:
        first = parallel.simulate(rows)
        assert first.digest == serial.simulate(rows).digest
        assert parallel.simulate(rows).digest == first.digest


def test_slow_rows_get_all_workers_and_bring_the_same_bits():
    rows = _rows(40)
    with ParallelModel(SlowToy(row_s=0.05).open, 3) as model:
        answer = model.simulate(rows)
        assert model.n_processes == 3
    assert answer.digest == ToyRC().simulate(rows).digest


def test_little_work_gets_one_worker():
    with ParallelModel(ToyRC, 4) as model:
        for n in (1, 15, 200):
            model.simulate(_rows(n))
        assert model.n_processes == 1


def test_a_slow_start_hires_nobody():
    with ParallelModel(WarmingToy().open, 4) as model:
        model.simulate(_rows(30))
        assert model.n_processes == 1


def test_a_described_recipe_is_known_without_a_process():
    toy = SlowToy()
    with ParallelModel(toy.open, 2) as model:
        assert model.parameter_space == toy.parameter_space
        assert model.output_names == ("T",)
        assert np.array_equal(model.time, toy.time)
        assert model.simulate(np.empty((0, 2))).n == 0
        assert model.n_processes == 0


def test_a_large_batch_comes_in_blocks(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.spooled_model.BLOCK_BYTES", 20_000)
    rows, seen = _rows(350), []
    with ParallelModel(ToyRC, 2) as model:
        blocks = list(model.stream(rows, on_progress=seen.append))
    assert [block.n for block in blocks] == [100, 100, 100, 50]
    assert np.array_equal(np.concatenate([block.y for block in blocks]), ToyRC().simulate(rows).y)
    assert seen == sorted(seen)
    assert seen[-1] == 350


def test_batches_of_all_sizes_do_not_touch_each_other():
    with ParallelModel(ToyRC, 2) as model:
        answers = [(n, model.simulate(_rows(n))) for n in (3, 70, 1, 30_000, 2)]
    for n, answer in answers:
        assert answer.digest == ToyRC().simulate(_rows(n)).digest


def test_a_model_can_be_asked_between_two_blocks_of_a_stream(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.spooled_model.BLOCK_BYTES", 2_000)
    rows = _rows(25)
    with ParallelModel(ToyRC, 2) as model:
        for start, block in zip((0, 10, 20), model.stream(rows), strict=True):
            assert model.simulate(rows[:3]).digest == ToyRC().simulate(rows[:3]).digest
            assert block.digest == ToyRC().simulate(rows[start : start + 10]).digest


def test_the_cores_are_those_this_process_may_use():
    assert ParallelModel(ToyRC).n_workers == available_cores()
    assert available_cores() == len(os.sched_getaffinity(0))


def test_no_worker_is_no_choice():
    with pytest.raises(ValueError, match="n_workers is 0"):
        ParallelModel(ToyRC, 0)


def test_rows_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"theta has shape \(3, 4\); expected \(n, 2\)"):
        ParallelModel(SlowToy().open).simulate(np.ones((3, 4)))


def test_a_model_that_cannot_be_opened_says_so_in_its_own_line():
    with ParallelModel(PickyToy().open, 2) as model, pytest.raises(InputError) as caught:
        model.simulate(_rows(3))
    assert str(caught.value) == "picky.fmu: there is no licence; ask for one"


@pytest.mark.parametrize("recipe", ["Own", "partial(Own, fails_above_r=3.0)"])
def test_a_recipe_that_no_other_process_can_find_is_refused(recipe: str, tmp_path: Path):
    script = tmp_path / "own.py"
    script.write_text(
        "from functools import partial\n"
        "from simulation.workers.parallel import ParallelModel\n"
        "from simulation.toy import ToyRC\n"
        "class Own(ToyRC): pass\n"
        f"ParallelModel({recipe}).time\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, cwd=ROOT, timeout=60,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 1
    assert "is defined in the script itself" in done.stderr


def test_a_recipe_that_cannot_be_pickled_is_told_what_would_do():
    with pytest.raises(
        RuntimeError, match=r"cannot be sent to worker processes .*; give a function of a module"
    ):
        ParallelModel(lambda: ToyRC()).simulate(_rows(1))


def test_who_is_interrupted_again_and_again_can_go_on(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.workforce._MAX_STARTS", 2)
    rows, here = _rows(5), threading.main_thread().ident
    assert here is not None
    with ParallelModel(SlowToy().open, 1) as model:
        for _ in range(3):
            end_resting()
            # The process that workers come from has just been started.
            threading.Timer(0.03, signal.pthread_kill, (here, signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                model.simulate(rows)
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest


SCRIPT = """
import sys
sys.path[:0] = [{tests!r}, {root!r}]
import numpy as np
from simulation.workers.parallel import ParallelModel
from slow_models import SlowToy

rows = SlowToy().parameter_space.from_unit(np.random.default_rng(0).random((4000, 2)))
with ParallelModel(SlowToy, 2) as model:
    model.simulate(rows[:20])
    print("ready", flush=True)
    model.simulate(rows)
"""


# Without a guard: a script need not know that there are processes.
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_no_worker_and_no_file_outlives_its_parent(how: signal.Signals, tmp_path: Path):
    script, temporary = tmp_path / "work.py", tmp_path / "tmp"
    temporary.mkdir()
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent), root=str(ROOT)))
    with subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"TMPDIR": str(temporary)},
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2
        assert list(temporary.iterdir())
        time.sleep(0.1)
        started = time.monotonic()
        process.send_signal(how)
        process.wait(timeout=20)
        _, alive = psutil.wait_procs(workers, timeout=10)
        assert not alive
        # The batch would have taken 100 s; "within a second" is what it takes on an idle machine.
        assert time.monotonic() - started < 5
    assert not list(temporary.iterdir())


def test_a_model_instead_of_its_recipe_is_refused():
    with pytest.raises(InputError, match=r"a recipe for the model, as case\.make_model, not a ToyRC"):
        ParallelModel(ToyRC(), 2)
