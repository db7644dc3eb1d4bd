"""Threads beside each other change no bit of a surrogate, and end soon when nobody waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest
import torch
from rc_step_for_tests import PROCESSES, waves

from pelsvae import process_fitting
from pelsvae.epochs import EpochReport
from pelsvae.side_by_side import GivenUpError, side_by_side
from pelsvae.training import fit


@pytest.fixture
def small_is_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let threads work on few rows, networks included."""
    monkeypatch.setattr(process_fitting, "THREADED_ROWS", 1)
    monkeypatch.setattr(process_fitting, "MANY_ROWS", 50)


def fitted(n_threads: int, on_epoch: Callable[[EpochReport], None] | None = None) -> dict[str, torch.Tensor]:
    config = PROCESSES.replace(max_epochs=5, n_threads=n_threads)
    made = fit(*waves(50, seed=1), waves(60, seed=2), config=config, seed=0, on_epoch=on_epoch)
    return made.surrogate.network.state_dict()


@pytest.mark.usefixtures("small_is_many")
def test_however_many_threads_the_surrogate_is_the_same() -> None:
    alone, beside = fitted(n_threads=1), fitted(n_threads=3)
    assert any(name.startswith("networks.") for name in alone)
    assert alone.keys() == beside.keys()
    for name, value in alone.items():
        assert torch.equal(value, beside[name]), name


@pytest.mark.usefixtures("small_is_many")
def test_what_ends_a_fit_ends_its_threads() -> None:
    def interrupt(report: EpochReport) -> None:
        raise KeyboardInterrupt

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        fitted(n_threads=2, on_epoch=interrupt)
    assert threading.active_count() == before


def test_a_computation_ends_at_its_next_check_when_the_block_ends() -> None:
    begun, ended = threading.Event(), []

    def long() -> None:
        begun.set()
        try:
            while True:
                threads.check()
                time.sleep(0.01)
        except GivenUpError:
            ended.append(True)
            raise

    with side_by_side(2) as threads:
        threads.later(long)
        assert begun.wait(60.0)
    assert ended == [True]


@pytest.mark.parametrize("n_jobs", [1, 3])
def test_answers_come_in_the_order_of_their_questions(n_jobs: int) -> None:
    with side_by_side(n_jobs) as threads:
        later = threads.later(lambda: 7)
        assert list(threads.each(lambda number: number * number, range(20))) == [n * n for n in range(20)]
        assert later() == later() == 7
        assert torch.get_num_threads() == 1
