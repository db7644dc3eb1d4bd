"""What models do to their processes costs exactly the row that did it, with a reason."""

import logging
import math
import re
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from simulation.errors import InputError
from simulation.toy import ToyRC
from simulation.workers.arena import Arena, recover_arenas
from simulation.workers.execution import CampaignStopped, ExecutionPolicy
from simulation.workers.messages import Ended
from simulation.workers.nursery_process import end_resting
from simulation.workers.parallel import ParallelModel
from simulation.workers.workforce import Workforce

sys.path.insert(0, str(Path(__file__).parent))
from slow_models import (
    BAD_ABOVE_R,
    CrashingToy,
    DyingAtOpeningToy,
    ExitingToy,
    FamilyToy,
    HangingToy,
    LeakingToy,
    OnceCrashingToy,
    OncePerProcessToy,
    PickyToy,
    RaisingToy,
    SlowlyOpeningToy,
    SlowToy,
    count_begun,
)


def _rows(n: int, n_bad: int) -> np.ndarray:
    """Return rows of which some, here and there, have an R that misbehaves."""
    rng = np.random.default_rng(5)
    rows = ToyRC().parameter_space.from_unit(rng.random((n, 2)))
    rows[:, 0] = np.minimum(rows[:, 0], BAD_ABOVE_R)
    rows[rng.choice(n, n_bad, replace=False), 0] = 4.5
    return rows


@pytest.mark.parametrize(
    ("toy", "reason"),
    [
        (CrashingToy(), "2 times: the FMU crashed its process (SIGSEGV); last message: about to fall"),
        (ExitingToy(), "2 times: the FMU ended its process with exit code 3"),
        (HangingToy(), "did not answer within 0.4 s and was stopped"),
        (RaisingToy(), "ValueError: R is too large"),
        (RaisingToy(error=MemoryError), "out of memory"),
    ],
    ids=["crashes", "exits", "hangs", "raises", "out-of-memory"],
)
def test_of_a_thousand_rows_exactly_the_bad_ones_fail(toy: SlowToy, reason: str):
    rows = _rows(1000, 8)
    with ParallelModel(toy.open, 2, policy=ExecutionPolicy(timeout_s=0.4)) as model:
        answer = model.simulate(rows)
    bad = rows[:, 0] > BAD_ABOVE_R
    assert np.array_equal(answer.failed, bad)
    assert {why for why in answer.failures if why} == {reason}
    assert answer.take(~bad).digest == ToyRC().simulate(rows[~bad]).digest


def test_a_row_that_was_unlucky_once_is_good(tmp_path: Path):
    rows = _rows(30, 3)
    with ParallelModel(OnceCrashingToy(folder=tmp_path).open, 2) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest


def test_retries_are_the_policy_s(tmp_path: Path):
    rows = _rows(6, 2)
    for retries, timeout_retries, toy in ((0, 0, CrashingToy), (2, 0, CrashingToy), (0, 1, HangingToy)):
        begun = tmp_path / f"{retries}-{timeout_retries}"
        policy = ExecutionPolicy(timeout_s=0.3, retries=retries, timeout_retries=timeout_retries)
        with ParallelModel(toy(begun=begun).open, 2, policy=policy) as model:
            model.simulate(rows)
        counts = count_begun(begun)
        bad = {row.tobytes().hex() for row in rows if row[0] > BAD_ABOVE_R}
        assert {counts[row] for row in bad} == {1 + retries + timeout_retries}
        assert {n for row, n in counts.items() if row not in bad} == {1}


def test_a_process_that_grows_is_replaced_before_it_harms(caplog: pytest.LogCaptureFixture):
    rows = _rows(60, 0)
    seen = set()
    policy = ExecutionPolicy(max_growth_mb=200.0)
    with ParallelModel(LeakingToy().open, 1, policy=policy) as model:
        for start in range(0, 60, 4):
            answer = model.simulate(rows[start : start + 4])
            assert answer.digest == ToyRC().simulate(rows[start : start + 4]).digest
            for process in psutil.Process().children(recursive=True):
                seen.add(process.pid)
                # 200 MB, the row that crossed them, and what Python itself needs.
                assert process.memory_info().rss < 400e6
    assert len(seen) >= 60 * 20 / 240


def test_a_process_is_replaced_after_the_rows_it_may_simulate():
    with ParallelModel(SlowToy(row_s=0.0).open, 1, policy=ExecutionPolicy(max_rows_per_process=7)) as model:
        rows = _rows(30, 0)
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest


def test_a_model_that_works_once_per_process_gets_one_for_every_row():
    rows = _rows(25, 0)
    with ParallelModel(OncePerProcessToy().open, 2) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest


def test_many_processes_that_ask_for_another_at_once_are_no_reason_to_stop():
    # Rows so long travel one by one, and processes in step come to their second one together.
    rows = _rows(60, 0)
    with ParallelModel(OncePerProcessToy(row_s=0.05).open, 8) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest


def test_a_dead_nursery_is_replaced_after_the_end_of_its_workers_was_told():
    workforce = Workforce(SlowToy().open, 2, policy=ExecutionPolicy(), on_warning=print)
    end_resting()
    before = set(psutil.Process().children())
    try:
        workforce.open()
        (worker,) = workforce.workers
        for nursery in set(psutil.Process().children()) - before:
            nursery.kill()
            psutil.wait_procs([nursery])
        workforce.ask_for(2)
        # Whoever gave it rows gets them back only so.
        assert workforce.wait(5.0) == [(worker, Ended(worker.number, None))]
        workforce.open()
        assert workforce.workers
    finally:
        workforce.close(at_once=True)


def test_a_campaign_that_mostly_fails_stops_and_says_why(tmp_path: Path):
    rows = np.full((500, 2), [4.5, 1e4])
    rows[::3, 0] = 1.0
    begun = tmp_path / "begun"
    with ParallelModel(RaisingToy(begun=begun, row_s=0.01).open, 2) as model:
        with pytest.raises(CampaignStopped) as caught:
            model.simulate(rows)
        assert "more than simulation.max_failed_share = 0.5 allows" in str(caught.value)
        assert "ValueError: R is too large" in str(caught.value)
        assert "\n" not in str(caught.value)
        assert len(begun.read_text().split()) < 100
        # It can be asked again.
        assert not model.simulate(rows[::3]).failed.any()


def test_one_licence_means_one_worker_and_one_warning(tmp_path: Path):
    rows, warnings = _rows(80, 0), []
    toy = PickyToy(licence=tmp_path / "licence")
    with ParallelModel(toy.open, 3, on_warning=warnings.append) as model:
        assert model.simulate(rows).digest == ToyRC().simulate(rows).digest
    assert len(warnings) == 1
    assert warnings[0].startswith("only 1 of 3 processes can open the model at once")


def test_max_workers_asks_for_no_licence_that_is_not_there(tmp_path: Path):
    warnings: list[str] = []
    toy = PickyToy(licence=tmp_path / "licence")
    policy = ExecutionPolicy(max_workers=1)
    with ParallelModel(toy.open, 3, policy=policy, on_warning=warnings.append) as model:
        assert model.n_workers == 1
        assert not model.simulate(_rows(40, 0)).failed.any()
    assert not warnings


def test_a_model_that_dies_when_opened_is_an_error_of_the_user():
    with (
        ParallelModel(DyingAtOpeningToy().open, 2) as model,
        pytest.raises(InputError, match=r"opening it crashed its process \(SIGABRT\)"),
    ):
        model.simulate(_rows(3, 0))


def test_a_model_that_does_not_open_is_told_of_or_stopped(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.workforce._MIN_OPENING_S", 0.2)
    warnings: list[str] = []
    with ParallelModel(SlowlyOpeningToy().open, 1, on_warning=warnings.append) as model:
        assert not model.simulate(_rows(3, 0)).failed.any()
    assert len(warnings) == 1
    assert "has been opening for 0.2 s" in warnings[0]
    policy = ExecutionPolicy(timeout_s=0.2)
    with (
        ParallelModel(SlowlyOpeningToy(opening_s=1e6).open, 1, policy=policy) as model,
        pytest.raises(InputError, match=r"did not open within 0\.2 s and was stopped"),
    ):
        model.simulate(_rows(3, 0))


def test_what_finished_before_a_campaign_stopped_is_in_the_spool(tmp_path: Path):
    rows = np.full((60, 2), [4.5, 1e4])
    rows[:10, 0] = np.linspace(1.0, 2.0, 10)
    with ParallelModel(RaisingToy().open, 1, spool=tmp_path) as model:
        with pytest.raises(CampaignStopped):
            model.simulate(rows)
        (found,) = recover_arenas(tmp_path)
        assert found.take(~found.failed).digest == ToyRC().simulate(rows[:10]).digest
        assert 10 <= found.failed.sum() < 50


def test_a_batch_is_in_the_spool_until_the_next(tmp_path: Path):
    for n in (3, 40_000):
        rows = _rows(n, 0)
        with ParallelModel(ToyRC, 1, spool=tmp_path) as model:
            model.simulate(rows)
            (file,) = tmp_path.iterdir()
            assert Arena.attach(str(file)).finished().digest == ToyRC().simulate(rows).digest
            model.simulate(rows[:0])
            assert not [file for file in tmp_path.iterdir() if Arena.attach(str(file)).n]
        assert not list(tmp_path.iterdir())


def test_what_a_model_starts_and_writes_goes_with_its_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    end_resting()
    before = set(psutil.Process().children(recursive=True))
    with ParallelModel(FamilyToy().open, 1) as model:
        model.simulate(_rows(3, 0))
        family = set(psutil.Process().children(recursive=True)) - before
        assert sum(process.name() == "sleep" for process in family) == 3
        assert list(tmp_path.rglob("left.txt"))
    assert not list(tmp_path.iterdir())
    end_resting()
    _, alive = psutil.wait_procs(family, timeout=5)
    assert not alive


def test_a_forgotten_model_leaves_no_process():
    end_resting()
    before = set(psutil.Process().children(recursive=True))
    model = ParallelModel(SlowToy().open, 2)
    model.simulate(_rows(20, 0))
    family = set(psutil.Process().children(recursive=True)) - before
    assert family
    del model
    _, alive = psutil.wait_procs(family, timeout=5)
    assert not alive


def test_a_slow_row_is_reported_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("simulation.workers.campaign._SLOW_S", 0.3)
    warnings: list[str] = []
    rows = _rows(20, 1)
    policy = ExecutionPolicy(timeout_s=1.0)
    with ParallelModel(HangingToy().open, 1, policy=policy, on_warning=warnings.append) as model:
        model.simulate(rows)
    (warning,) = warnings
    assert warning.startswith(f"row {int(np.argmax(rows[:, 0]))} has been running for 0.")
    assert warning.endswith("it will be stopped after 1 s")


def test_without_a_time_out_the_slowest_row_so_far_tells_how_long_to_wait():
    rows = _rows(20, 1)
    policy = ExecutionPolicy(least_limit_s=0.3)
    with ParallelModel(HangingToy().open, 2, policy=policy) as model:
        answer = model.simulate(rows)
        # The next batch remembers.
        again = model.simulate(rows[rows[:, 0] > 4.0])
    assert answer.failed.sum() == 1
    for reason in (max(answer.failures), again.failures[0]):
        assert re.match(
            r"did not answer within .* s and was stopped \(no \[simulation\] timeout_s is", reason
        )


def test_a_row_may_take_as_long_as_it_likes_where_the_time_out_is_infinite():
    assert ExecutionPolicy(timeout_s=math.inf).limit_s(1e-3) == math.inf
    assert ExecutionPolicy().limit_s(None) == math.inf
    assert ExecutionPolicy().limit_s(3.0) == 300.0
    assert ExecutionPolicy().limit_s(1e-3) == 60.0
    policy = ExecutionPolicy(timeout_s=math.inf, least_limit_s=0.01)
    with ParallelModel(SlowToy(row_s=0.4).open, 1, policy=policy) as model:
        assert not model.simulate(_rows(3, 0)).failed.any()


def test_a_slow_row_holds_up_no_other():
    rows = _rows(100, 1)
    rows[:, 0] = 1.0
    rows[3, 0] = 4.5
    reached: dict[int, float] = {}
    policy = ExecutionPolicy(timeout_s=3.0)
    with ParallelModel(HangingToy(row_s=0.01).open, 2, policy=policy) as model:
        for _ in model.stream(rows, on_progress=lambda n: reached.setdefault(n, time.monotonic())):
            pass
    # All others are done long before the hanging one is given up; behind it they would take a tenth of this.
    assert reached[100] - reached[99] > 0.5


def test_nothing_is_said_when_all_is_well(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.WARNING), ParallelModel(SlowToy(row_s=0.01).open, 2) as model:
        model.simulate(_rows(60, 0))
    assert not caplog.records
