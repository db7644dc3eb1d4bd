"""No simulation is changed by those before it: each has a process of its own, or some are repeated."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from forgetful_fmu import FAULTS, forgetful_settings, store_of

from simulation import PoolModel, uniform_design
from simulation.arrays import FloatArray
from simulation.errors import ReuseError
from simulation.fmi.fmu import FmuSettings
from simulation.pool.worker_process import NewProcess
from simulation.store.reuse_check import N_REPEATED
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories

N, N_KEPT = 160, 12


def design(settings: FmuSettings, n: int, seed: int) -> FloatArray:
    return uniform_design(settings.parameter_space, n, seed)


@pytest.fixture
def truth(tmp_path: Path) -> Trajectories:
    """The answers of an FMU that forgets, of which its own pool's tests are sure."""
    settings = forgetful_settings(tmp_path)
    with settings.open() as model:
        return model.simulate(design(settings, N, 0))


@pytest.fixture
def processes_are_dear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows share processes, as those of FMUs do that take long to load."""
    monkeypatch.setattr("simulation.pool.pool_model._UNNOTICED_S", 0.0)


@pytest.mark.parametrize("fault", FAULTS)
def test_rows_that_share_processes_are_found_wrong_and_none_stays(
    tmp_path: Path, processes_are_dear: None, fault: str
) -> None:
    settings = forgetful_settings(tmp_path, fault)
    theta = design(settings, N, 0)
    with store_of(settings, tmp_path / "rows.db") as store:
        with PoolModel(settings.open, 1) as pool, suppress(ReuseError):
            StoredModel(pool, store).complete(theta)
            # Its reset was given up for new instances or processes at once, in which the fault does not show.
            assert not store.is_reuse_given_up
        with PoolModel(settings.open, 1) as pool:
            StoredModel(pool, store).complete(theta[:N_KEPT])
            right = pool.simulate(theta[:N_KEPT], NewProcess.EACH_ROW)
        assert store.read(theta[:N_KEPT]).digest == right.digest
        assert not (store.is_reuse_given_up and len(store.theta_reused))


@pytest.mark.parametrize("fault", ["DISCRETE_STATE", "PARAMETER_CACHED", "COUNTER"])
def test_small_batches_need_no_finding_as_each_row_has_a_process_of_its_own(
    tmp_path: Path, fault: str
) -> None:
    settings = forgetful_settings(tmp_path, fault)
    theta = design(settings, 12, 0)
    with PoolModel(settings.open, 1) as pool, store_of(settings, tmp_path / "rows.db") as store:
        stored = StoredModel(pool, store)
        right = pool.simulate(theta, NewProcess.EACH_ROW)
        answers = [stored.simulate(theta[start : start + 3]) for start in range(0, 12, 3)]
        assert store.first(theta).all()
    assert Trajectories.concatenate(answers).digest == right.digest


def test_a_sound_fmu_shares_processes_and_pays_a_few_rows(
    tmp_path: Path, truth: Trajectories, processes_are_dear: None
) -> None:
    settings = forgetful_settings(tmp_path)
    with PoolModel(settings.open, 1) as pool, store_of(settings, tmp_path / "rows.db") as store:
        stored = StoredModel(pool, store)
        assert np.array_equal(stored.simulate(truth.theta).y, truth.y)
        assert 0 < stored.reuse.n_repeated <= 2 * N_REPEATED
        # All but the first rows of the process and of what it took to know what a process costs.
        assert len(store.theta_reused) >= N - 4
        assert stored.repeats(truth.theta[-1])


def test_the_best_row_is_repeated_before_it_is_shown(tmp_path: Path, processes_are_dear: None) -> None:
    settings = forgetful_settings(tmp_path, "COUNTER")
    theta = design(settings, 60, 0)
    with PoolModel(settings.open, 1) as pool, store_of(settings, tmp_path / "rows.db") as store:
        # As if rows were too few for a check: those of one process, of which the later ones are wrong.
        for _, rows, is_first in pool.as_finished(theta, NewProcess.AT_FIRST):
            store.append(rows, is_first)
        stored = StoredModel(pool, store)
        assert stored.repeats(theta[3])
        with pytest.raises(ReuseError, match="59 stored simulations"):
            stored.repeats(theta[-1])
        assert store.find(theta).sum() == 1


def test_a_store_of_an_earlier_version_doubts_all_its_rows(tmp_path: Path, truth: Trajectories) -> None:
    settings = forgetful_settings(tmp_path)
    file = tmp_path / "rows.db"
    with store_of(settings, file) as store:
        store.append(truth)
        assert store.first(truth.theta).all()
        store._database.execute("alter table simulations drop column _first")
    with store_of(settings, file) as store:
        assert not store.first(truth.theta).any()
        assert np.array_equal(store.theta_reused, truth.theta)
        assert np.array_equal(store.read(truth.theta).y, truth.y)


def test_which_rows_begin_in_a_new_process_can_be_chosen(tmp_path: Path, truth: Trajectories) -> None:
    settings = forgetful_settings(tmp_path, "COUNTER")
    with PoolModel(settings.open, 1) as pool:
        for how, n_first in ((NewProcess.AT_FIRST, 1), (NewProcess.EACH_ROW, 6), (NewProcess.AT_FIRST, 1)):
            chunks = list(pool.as_finished(truth.theta[:6], how))
            assert sum(int(chunk.is_first.sum()) for chunk in chunks) == n_first
