"""A model whose states are watched answers as one whose states are not, and shares what it answered."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
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
from studies.calibration.states import StateSignals
from studies.watched_model import StoredWatchedModel

TOY = ToyRC(fails_above_r=4.0)
SIGNALS = StateSignals(
    states=("s",),
    derivatives=("der(s)",),
    inputs=(),
    units=("",),
    depends_on=(None,),
    driven=np.zeros((len(TOY.time) - 1, 0)),
    step_s=1.0,
    every=1,
    n_before=0,
    outputs=TOY.output_names,
    conversions=np.tile([1.0, 0.0], (len(TOY.output_names), 1)),
)


class ShowsStates(WrappedModel):
    """The toy, a state and its derivative beside its outputs; or all rows fail where states are read."""

    def __init__(self, *, can_be_read: bool) -> None:
        super().__init__(TOY)
        self._can_be_read = can_be_read

    @property
    def output_names(self) -> tuple[str, ...]:
        return (*TOY.output_names, "s", "der(s)")

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = TOY.simulate(theta)
        states = np.tile(answer.theta[:, None, :1], (1, len(TOY.time), 2))
        failures = answer.failures if self._can_be_read else ("no such variable",) * answer.n
        return Trajectories.checked(
            answer.theta,
            np.concatenate([answer.y, states], axis=-1),
            time=TOY.time,
            parameter_names=answer.parameter_names,
            output_names=self.output_names,
            failures=failures,
        )


@dataclass
class Opened:
    """A watched model in a folder, and how often the two models under it were asked."""

    model: StoredWatchedModel
    plain: CountingModel
    watched: CountingModel


@dataclass
class Opens:
    """Opens it, again and again."""

    folder: Path
    stack: ExitStack = field(default_factory=ExitStack)

    def stored(self, model: ForwardModel, name: str) -> StoredModel:
        store = SimulationStore(
            self.folder / name,
            model_digest=name,
            parameter_names=TOY.parameter_space.names,
            output_names=model.output_names,
            time=TOY.time,
        )
        return StoredModel(model, self.stack.enter_context(store))

    def __call__(self, *, can_be_read: bool = True) -> Opened:
        plain, watched = CountingModel(TOY), CountingModel(ShowsStates(can_be_read=can_be_read))
        model = StoredWatchedModel(self.stored(plain, "plain"), self.stored(watched, "watched"), SIGNALS)
        return Opened(model, plain, watched)


@pytest.fixture
def opens(tmp_path: Path) -> Iterator[Opens]:
    opens = Opens(tmp_path)
    with opens.stack:
        yield opens


def rows(n: int, *, fail: bool = False) -> FloatArray:
    theta = uniform_design(TOY.parameter_space, 200, 0)
    return theta[TOY.simulate(theta).failed == fail][:n]


def test_what_it_answers_is_everybodys_and_asked_once(opens: Opens) -> None:
    theta = np.concatenate([rows(5), rows(1, fail=True)])
    first = opens()
    assert first.model.simulate(theta).digest == TOY.simulate(theta).digest
    assert (first.watched.n_calls, first.plain.n_calls) == (6, 0)
    assert first.model.failures == [TOY.simulate(rows(1, fail=True)).failures[0]]
    assert first.model.watched(theta).tolist() == [True] * 5 + [False]
    assert first.model.seen(theta).x[:5, 0, 0].tolist() == theta[:5, 0].tolist()
    again = opens()
    assert again.model.simulate(theta).digest == TOY.simulate(theta).digest
    assert (again.model.n_simulated, again.model.n_reused) == (0, 6)
    plain = opens.stored(TOY, "plain")
    assert plain.simulate(theta[:5]).digest == TOY.simulate(theta[:5]).digest
    assert plain.n_simulated == 0


def test_states_that_cannot_be_read_cost_two_rows(opens: Opens) -> None:
    theta = np.concatenate([rows(1, fail=True), rows(6)])
    opened = opens(can_be_read=False)
    assert opened.model.simulate(theta).digest == TOY.simulate(theta).digest
    # The first row fails in any case, so it does not show whether states can be read.
    assert (opened.watched.n_calls, opened.plain.n_calls) == (3, 7)
    assert opened.model.n_asked_twice == 3
    assert opened.model.why_unread == "no such variable"
    assert len(opened.model.failures) == 1
    assert np.isnan(opened.model.seen(theta).x).all()
    again = opens(can_be_read=False)
    assert again.model.simulate(theta).digest == TOY.simulate(theta).digest
    assert (again.watched.n_calls, again.plain.n_calls, again.model.n_asked_twice) == (0, 0, 3)


def test_what_is_watched_alone_fails_no_row() -> None:
    case = load_case(Path(__file__).parents[2] / "fmus" / "wall")
    anything = np.array([-np.inf, np.inf])
    for is_watched, n_failed in ((True, 0), (False, 1)):
        settings = replace(case.settings, accepted=np.array([anything, [0.0, 1.0]]), is_watched=is_watched)
        with settings.open() as model:
            assert model.simulate(case.parameter_space.expected[None]).failed.sum() == n_failed
