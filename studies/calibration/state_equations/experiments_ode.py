"""State equations of several experiments: each learns those of its own rows, and all propose one point.

The model is the same, but inputs, start and fixed values are not. Each experiment's equations fit its own
states; the residuals of all are minimized together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.experiments import JoinedModel
from simulation.forward_model import ForwardModel
from simulation.layout import Layout
from simulation.parameters import ParameterSpace
from simulation.store.joined_store import StoredExperiments
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN, Points
from studies.calibration.state_equations.learned_ode import LearnedODE, enough_for_equations
from studies.calibration.state_equations.learner import EquationLearner
from studies.calibration.state_equations.states import StateSignals, WatchedModel, watching_states


@dataclass(frozen=True, eq=False)
class _Part:
    """The look of one experiment's watched model; its rows come with those of the others."""

    parameter_space: ParameterSpace
    output_names: tuple[str, ...]
    time: FloatArray

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Refuse: all experiments are asked at once."""
        raise NotImplementedError("the rows of an experiment come with those of the others")


class WatchedExperiments(WatchedModel):
    """Several experiments as one model that answers their outputs and remembers what their states did."""

    def __init__(
        self, model: ForwardModel, watched: Layout, reported: Layout, parts: Sequence[WatchedModel]
    ) -> None:
        """Wrap a model.

        Args:
            model: The experiments with all that is watched.
            watched: How its rows are made.
            reported: How the outputs alone become rows.
            parts: What is watched of each experiment.
        """
        self._model = model
        self._layout, self._reported = watched, reported
        self.parts, self.signals = parts, parts[0].signals

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs of all experiments, without what is watched."""
        return self._reported.output_names

    @property
    def time(self) -> FloatArray:
        """Times of the outputs that are reported. Shape (t,). [s]."""
        return self._reported.time

    def forget(self) -> None:
        """Forget what the states did."""
        for part in self.parts:
            part.forget()

    def simulate_more(self, theta: FloatArray) -> Trajectories:
        """Simulate every row in all experiments, and remember the rows before, too."""
        answer = self._model.simulate(theta)
        watched = self._layout
        reported = [
            part.remember(watched.part(one, answer, part.watched_names, part.watched_time))
            for one, part in zip(watched.experiments, self.parts, strict=True)
        ]
        return self._reported.join(theta, reported)

    def simulate_alone(self, theta: FloatArray, place: int) -> Trajectories:
        """Simulate every row in one experiment, and remember the rows before, too.

        Args:
            theta: Parameters of all experiments. Shape (n, p). [per parameter]
            place: Which experiment.

        Returns:
            Its own outputs.
        """
        assert isinstance(self._model, JoinedModel | StoredExperiments), "the experiments' own model"
        return self.parts[place].remember(self._model.simulate_alone(theta, place))


@dataclass(frozen=True, eq=False)
class SingleExperiments:
    """Equations that are learnt in few experiments, and taken over in those that differ in values alone.

    Attributes:
        cases: The experiments.
        model: Watches the states of all of them.
        learners: Of every experiment.
        n_shown: How many points of the first design each has simulated.
    """

    cases: Sequence[Case]
    model: WatchedExperiments
    learners: Sequence[EquationLearner]
    n_shown: list[int]

    def learn(self, u: FloatArray) -> int:
        """Learn from points (n, p) of the first design; return how many simulations there were."""
        driven = [part.signals.driven for part in self.model.parts]
        n_moving = [int((signal != signal[0]).any(axis=0).sum()) for signal in driven]
        # What rests in an experiment shows nothing there; of the others the shortest costs least.
        order = sorted(range(len(driven)), key=lambda index: (-n_moving[index], len(driven[index])))
        known = list[int]()
        for index in order:
            is_led = any(self._follows(index, leader, u) for leader in known)
            if not is_led and not self._learn_in(index, u):
                break
            known.append(index)
        return sum(self.n_shown)

    def _learn_in(self, index: int, u: FloatArray) -> bool:
        """Simulate one experiment alone, as far as its equations need it; return whether they are sure."""
        learner = self.learners[index]
        most = min(enough_for_equations(learner.problem.space.n_parameters), len(u))
        for n in range(LEAST_TO_LEARN, most + 1):
            learner.note(self._simulated_in(index, u[:n]), is_proposed=False)
            if learner.is_sure:
                return True
        return False

    def _simulated_in(self, index: int, u: FloatArray) -> Evaluation:
        """Simulate points of the first design in one experiment alone, those that it has not simulated."""
        points = u[self.n_shown[index] :]
        self.n_shown[index] = len(u)
        answer = self.model.simulate_alone(self.model.parameter_space.from_unit(points), index)
        learner = self.learners[index]
        return learner.problem.judge(points[:, learner.parameters], answer)

    def _follows(self, index: int, leader: int, u: FloatArray) -> bool:
        """Let an experiment follow another one's equations, where these or one row say what they are here."""
        mine, its, learner = self.cases[leader], self.cases[index], self.learners[index]
        equations, misfit = self.learners[leader].equations, self.learners[leader].known.misfit
        if equations is None or not mine.differs_in_values(its):
            return False
        pairs = [(value, its.fixed[name]) for name, value in mine.fixed.items() if its.fixed[name] != value]
        if any(isinstance(value, str | bool) for pair in pairs for value in pair):
            return False
        changed = [(float(here), float(there)) for here, there in pairs]
        follower = equations.in_experiment(self.model.parts[index].signals, changed)
        # Of two values that change something, one row does not say which does what.
        if follower is None or len(follower[1]) > 1:
            return False
        taken_over, unknown = follower
        if not unknown:
            learner.follow(taken_over, misfit)
            return True
        if self.n_shown[index]:
            return False
        here, there = unknown[0]
        answer = self._simulated_in(index, u[:1])
        rows, points = learner.seen(answer.theta), Points.of(learner.problem.space, answer.u)
        if rows.are_known.all():
            shown = taken_over.with_effect(points, rows, there - here, learner.known.products)
            if shown is not None:
                learner.follow(shown, misfit)
        learner.note(answer, is_proposed=False)
        return learner.is_sure


def watched_model(case: Case, model: ForwardModel) -> WatchedModel:
    """Return a model that answers a case's outputs and remembers what the states did.

    Args:
        case: The case, of one experiment or of several.
        model: The model of `watching_states(case)`.
    """
    if case.layout is None:
        return WatchedModel(model, StateSignals.of(case))
    with_states = watching_states(case)
    assert with_states.layout is not None, "as the case has one"
    parts = [
        WatchedModel(
            _Part(one.parameter_space, more.settings.output_names, more.scenario.time), StateSignals.of(one)
        )
        for one, more in zip(case.experiments, with_states.experiments, strict=True)
    ]
    return WatchedExperiments(model, with_states.layout, case.layout, parts)


def learned_ode(case: Case, model: WatchedModel, problem: CalibrationProblem) -> LearnedODE:
    """Return what learns the state equations of a case's problem.

    Args:
        case: The case, of one experiment or of several.
        model: What `watched_model` returned.
        problem: The problem.
    """
    if case.layout is None or not isinstance(model, WatchedExperiments):
        return LearnedODE([EquationLearner(model.signals, model.seen, problem)], problem)
    learners = [
        EquationLearner(part.signals, part.seen, CalibrationProblem(part, one.measurement), place)
        for part, one, place in zip(model.parts, case.experiments, case.layout.experiments, strict=True)
    ]
    single = SingleExperiments(case.experiments, model, learners, [0] * len(learners))
    return LearnedODE(learners, problem, single.learn)
