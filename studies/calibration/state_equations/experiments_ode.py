"""State equations of several experiments: each learns those of its own rows, and all propose one point.

The model is the same, but inputs, start and fixed values are not. Each experiment's equations fit its own
states; the residuals of all are minimized together.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case
from simulation.experiments import JoinedModel
from simulation.forward_model import ForwardModel
from simulation.layout import Experiment, Layout
from simulation.parameters import ParameterSpace
from simulation.store.joined_store import StoredExperiments
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.equation_model import EquationExperiments, EquationModel
from studies.calibration.state_equations.learned_ode import LearnedODE, enough_for_equations
from studies.calibration.state_equations.states import StateSignals, WatchedModel, watching_states


class _Part:
    """The look of one experiment's watched model; its rows come with those of the others."""

    def __init__(self, space: ParameterSpace, output_names: tuple[str, ...], time: FloatArray) -> None:
        self.parameter_space, self.output_names, self.time = space, output_names, time

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Refuse: all experiments are asked at once."""
        raise NotImplementedError("the rows of an experiment come with those of the others")


class WatchedExperiments(WatchedModel):
    """Several experiments as one model that answers their outputs and remembers what their states did."""

    def __init__(
        self,
        model: ForwardModel,
        watched: Layout,
        reported: Layout,
        parts: Sequence[WatchedModel],
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
        reported = []
        for one, part in zip(self._layout.experiments, self.parts, strict=True):
            names = part.parameter_space.names, part.watched_names
            rows = self._layout.part(one, answer, names, part.watched_time)
            part.remember(rows)
            reported.append(part.reported(rows))
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
        rows = self._model.simulate_alone(theta, place)
        self.parts[place].remember(rows)
        return self.parts[place].reported(rows)


class ExperimentsODE(LearnedODE):
    """The state equations of a calibration problem with several experiments."""

    def __init__(
        self,
        cases: Sequence[Case],
        layout: Layout,
        model: WatchedExperiments,
        problem: CalibrationProblem,
    ) -> None:
        """Begin with nothing known.

        Args:
            cases: The experiments.
            layout: How rows become one.
            model: Watches the states of all of them.
            problem: The problem of all experiments.
        """
        super().__init__(model.signals, model.parts[0].seen, problem)
        parts = [
            (part, CalibrationProblem(part, one.measurement))
            for part, one in zip(model.parts, cases, strict=True)
        ]
        self._parts = [LearnedODE(model.signals, model.seen, own) for model, own in parts]
        self._layout, self._cases, self._model = layout, cases, model
        self._of_each = list(zip(layout.experiments, self._parts, strict=True))
        self._n_shown = [0] * len(parts)

    @property
    def is_believed(self) -> bool:
        """Whether all experiments' equations are."""
        return all(part.is_believed for part in self._parts)

    @property
    def is_sure(self) -> bool:
        """Whether all experiments' equations are."""
        return all(part.is_sure for part in self._parts)

    @property
    def is_learnt(self) -> bool:
        """Whether all experiments have equations, believed or not."""
        return all(part.is_learnt for part in self._parts)

    @property
    def model(self) -> EquationModel | EquationExperiments | None:
        """A model that answers by the equations, None where they are not known exactly."""
        models = [part.model for part in self._parts]
        known = [one for one in models if isinstance(one, EquationModel)]
        if len(known) < len(models):
            return None
        return EquationExperiments(known, self._layout, self._problem.space)

    @property
    def hidden_inputs(self) -> tuple[str, ...]:
        """Names of the variables that any experiment's equations take as inputs beside the declared ones."""
        return tuple(dict.fromkeys(name for part in self._parts for name in part.hidden_inputs))

    @property
    def left_out(self) -> BoolArray:
        """Which parameters are in no equation of any experiment. Shape (p,)."""
        is_out = np.ones(self._problem.space.n_parameters, dtype=np.bool_)
        for one, part in self._of_each:
            is_out[one.parameters] &= part.left_out
        return is_out if self.is_learnt else np.zeros_like(is_out)

    def unseen(self, u: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
        """Return points where an experiment's equations may act that no row has shown, see `LearnedODE`."""
        by_experiment = []
        for one, part in self._of_each:
            points = np.tile(u, (n, 1))
            points[:, one.parameters] = part.unseen(u[one.parameters], n, rng)
            by_experiment.append(points)
        # The first of each experiment, then the second ones.
        return np.concatenate(np.stack(by_experiment, axis=1))[:n]

    def learn_alone(self, u: FloatArray) -> int:
        """Learn the equations in few experiments and take them over in those that differ in values alone.

        Args:
            u: Points of the first design. Shape (n, p). [1]

        Returns:
            How many whole rows the simulations are worth, rounded up.
        """
        # What rests in an experiment shows nothing there; of the others the shortest costs least.
        order = sorted(
            range(len(self._parts)), key=lambda one: (-self._n_moving(one), len(self._driven(one)))
        )
        known = list[int]()
        for place in order:
            is_led = any(self._follows(place, leader, u) for leader in known)
            if not is_led and not self._learn_in(place, u):
                break
            known.append(place)
        return math.ceil(self.n_alone / len(self._parts))

    def _driven(self, place: int) -> FloatArray:
        return self._model.parts[place].signals.driven

    def _n_moving(self, place: int) -> int:
        driven = self._driven(place)
        return int((driven != driven[0]).any(axis=0).sum())

    def _learn_in(self, place: int, u: FloatArray) -> bool:
        """Simulate one experiment alone, as far as its equations need it; return whether they are sure."""
        most = min(enough_for_equations(len(self._layout.experiments[place].parameters)), len(u))
        for n in range(LEAST_TO_LEARN, most + 1):
            self._parts[place].note(self._simulated_in(place, u[:n]))
            if self._parts[place].is_sure:
                return True
        return False

    def _simulated_in(self, place: int, u: FloatArray) -> Evaluation:
        """Simulate points of the first design in one experiment alone, those that it has not simulated."""
        points = u[self._n_shown[place] :]
        self._n_shown[place] = len(u)
        self.n_alone += len(points)
        answer = self._model.simulate_alone(self._problem.space.from_unit(points), place)
        own = self._layout.experiments[place].parameters
        return self._parts[place]._problem.judge(points[:, own], answer)

    def _follows(self, place: int, leader: int, u: FloatArray) -> bool:
        """Let an experiment follow another one's equations, where these or one row say what they are here."""
        mine, its, part = self._cases[leader], self._cases[place], self._parts[place]
        equations = self._parts[leader]._equations
        if equations is None or not mine.differs_in_values(its):
            return False
        pairs = [(value, its.fixed[name]) for name, value in mine.fixed.items() if its.fixed[name] != value]
        if any(isinstance(value, str | bool) for pair in pairs for value in pair):
            return False
        changed = [(float(here), float(there)) for here, there in pairs]
        found = equations.in_experiment(self._model.parts[place].signals, changed)
        # Of two values that change something, one row does not say which does what.
        if found is None or len(found[1]) > 1:
            return False
        follower, unknown = found
        if not unknown:
            part.follow(follower, self._parts[leader].misfit)
            return True
        if self._n_shown[place]:
            return False
        here, there = unknown[0]
        answer = self._simulated_in(place, u[:1])
        shown = part.with_effect(follower, answer, there - here)
        if shown is not None:
            part.follow(shown, self._parts[leader].misfit)
        part.note(answer)
        return part.is_sure

    def report_to(self, think_of: Callable[[str], None]) -> None:
        """Call this from now on with what is looked at in any experiment."""
        super().report_to(think_of)
        for part in self._parts:
            part.report_to(think_of)

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked, each experiment from its part."""
        self.n_asked += self.predicted is not None
        for one, part in self._of_each:
            part.predicted = self.predicted
            # What was simulated alone is no news in a whole row.
            if (is_new := ~part.knows(answer.u[:, one.parameters])).any():
                part.note(self._of(one, part._problem, answer, np.flatnonzero(is_new)))
        good = np.isfinite(answer.mse)
        self._u = np.concatenate([self._u, answer.u[good]])
        self._answers.add(answer.residuals[good])
        self.predicted = None
        self.misfit = max(part.misfit for part in self._parts)
        lacking = ((one.name, part.why_not) for one, part in self._of_each if not part.is_learnt)
        self.why_not = next((f"experiment {name}: {why}" for name, why in lacking), "")

    def _of(
        self, one: Experiment, problem: CalibrationProblem, answer: Evaluation, rows: IntArray
    ) -> Evaluation:
        """Return what some rows are in one experiment."""
        y = np.ascontiguousarray(answer.y[rows, : one.n_times][..., one.outputs])
        residuals = problem.measurement.compared(y)
        mse = np.where(np.isfinite(answer.mse[rows]), np.mean(residuals**2, axis=1), np.inf)
        return Evaluation(
            answer.u[np.ix_(rows, one.parameters)],
            self._layout.theta_of(one, answer.theta[rows]),
            y,
            residuals,
            mse,
            mse,
            tuple(answer.failures[row] for row in rows),
        )

    def _residuals(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Return the residuals (n, m), those after the first outputs as if the rest were zero."""
        measurement = self._problem.measurement
        y = np.zeros((len(u), len(measurement.time), len(measurement.output_names)))
        with np.errstate(all="ignore"):
            for one, part in self._of_each:
                n = min(n_outputs or one.n_times, one.n_times)
                y[:, :n, one.outputs] = part.outputs(u[:, one.parameters], None if n == one.n_times else n)
            return measurement.compared(y)


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
        return LearnedODE(model.signals, model.seen, problem)
    return ExperimentsODE(case.experiments, case.layout, model, problem)
