"""A model whose states are watched answers as one whose states are not, and shares what it answered."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from simulation.case import load_case
from simulation.counting import CountingModel
from simulation.design import uniform_design
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories
from studies.calibration.state_equations.states import StateSignals
from studies.physical_model import StoredWatchedModel

TOY = ToyRC(fails_above_r=4.0)
WALL = load_case(Path(__file__).parents[2] / "fmus" / "wall")
SIGNALS = StateSignals(
    states=("s",), derivatives=("der(s)",), inputs=(), units=("",), depends_on=(None,),
    driven=np.zeros((len(TOY.time) - 1, 0)), step_s=1.0, every=1, n_before=0, outputs=TOY.output_names,
    conversions=np.array([[1.0, 0.0]]),
)  # fmt: skip
Open = Callable[[bool], tuple[StoredWatchedModel, CountingModel, CountingModel]]


class ShowsStates(WrappedModel):
    """The toy, a state and its derivative beside its outputs; or all rows fail where states are read."""

    def __init__(self, can_be_read: bool) -> None:
        super().__init__(TOY)
        self._can_be_read = can_be_read

    @property
    def output_names(self) -> tuple[str, ...]:
        return (*TOY.output_names, "s", "der(s)")

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = TOY.simulate(theta)
        states = np.tile(answer.theta[:, None, :1], (1, len(TOY.time), 2))
        failures = answer.failures if self._can_be_read else ("no such variable",) * answer.n
        y = np.concatenate([answer.y, states], axis=-1)
        y[[bool(one) for one in failures]] = np.nan
        return replace(answer, y=y, output_names=self.output_names, failures=failures)


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Open]:
    """Open the watched model again and again, with counters of the plain and the watched one under it."""
    with ExitStack() as stack:

        def stored(model: ForwardModel, name: str) -> StoredModel:
            names = {"parameter_names": TOY.parameter_space.names, "output_names": model.output_names}
            store = SimulationStore(tmp_path / name, model_digest=name, time=TOY.time, **names)
            return StoredModel(model, stack.enter_context(store))

        def open_it(can_be_read: bool) -> tuple[StoredWatchedModel, CountingModel, CountingModel]:
            plain, watched = CountingModel(TOY), CountingModel(ShowsStates(can_be_read))
            return (
                StoredWatchedModel(stored(plain, "plain"), stored(watched, "watched"), SIGNALS),
                plain,
                watched,
            )

        yield open_it


def rows(n: int, *, fail: bool = False) -> FloatArray:
    theta = uniform_design(TOY.parameter_space, 200, 0)
    return theta[TOY.simulate(theta).failed == fail][:n]


def test_what_it_answers_is_everybodys_and_asked_once(opened: Open) -> None:
    theta = np.concatenate([rows(5), rows(1, fail=True)])
    model, plain, watched = opened(True)
    assert model.simulate(theta).digest == TOY.simulate(theta).digest
    assert (watched.n_calls, plain.n_calls) == (6, 0)
    assert model.failures == [TOY.simulate(rows(1, fail=True)).failures[0]]
    assert model.watched(theta).tolist() == [True] * 5 + [False]
    assert model.watching.seen(theta).x[:5, 0, 0].tolist() == theta[:5, 0].tolist()
    again, plain, _ = opened(True)
    assert again.simulate(theta).digest == TOY.simulate(theta).digest
    assert (again.n_simulated, again.n_reused, plain.n_calls) == (0, 6, 0)


def test_states_that_cannot_be_read_cost_two_rows(opened: Open) -> None:
    theta = np.concatenate([rows(1, fail=True), rows(6)])
    model, plain, watched = opened(False)
    assert model.simulate(theta).digest == TOY.simulate(theta).digest
    # The first row fails in any case, so it does not show whether states can be read.
    assert (watched.n_calls, plain.n_calls, model.n_asked_twice) == (3, 7, 3)
    assert model.why_unread == "no such variable"
    assert len(model.failures) == 1
    assert np.isnan(model.watching.seen(theta).x).all()
    again, plain, watched = opened(False)
    assert again.simulate(theta).digest == TOY.simulate(theta).digest
    assert (watched.n_calls, plain.n_calls, again.n_asked_twice) == (0, 0, 3)


def test_what_is_watched_alone_fails_no_row() -> None:
    anything = np.array([-np.inf, np.inf])
    for is_watched, n_failed in ((True, 0), (False, 1)):
        settings = replace(WALL.settings, accepted=np.array([anything, [0.0, 1.0]]), is_watched=is_watched)
        with settings.open() as model:
            assert model.simulate(WALL.parameter_space.expected[None]).failed.sum() == n_failed
