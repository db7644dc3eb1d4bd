"""State equations of several experiments: each learns those of its own rows, and all propose one point.

The model is the same, but inputs, start and fixed values are not. Each experiment's equations fit its own
states; the residuals of all are minimized together.
"""

from collections.abc import Sequence

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.experiments import Experiment, Layout
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.equation_model import EquationExperiments, EquationModel
from studies.calibration.learned_ode import LearnedODE
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.states import StateSignals, WatchedModel, watching_states


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
        parts: Sequence[tuple[ParameterSpace, tuple[str, ...], FloatArray, StateSignals]],
    ) -> None:
        """Wrap a model.

        Args:
            model: The experiments with all that is watched.
            watched: How its rows are made.
            reported: How the outputs alone become rows.
            parts: Of each experiment its parameters, the variables and times that are watched, and what is
                known of its states.
        """
        self._model = model
        self._layout, self._reported = watched, reported
        self.parts = tuple(WatchedModel(_Part(*part[:3]), part[3]) for part in parts)
        self.signals = self.parts[0].signals

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs of all experiments, without what is watched."""
        return self._reported.output_names

    @property
    def time(self) -> FloatArray:
        """Times of the outputs that are reported. Shape (t,). [s]."""
        return self._reported.time

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """Where what belongs to each experiment stands."""
        return self._reported.experiments

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


class ExperimentsODE(LearnedODE):
    """The state equations of a calibration problem with several experiments."""

    def __init__(
        self,
        parts: Sequence[tuple[WatchedModel, CalibrationProblem]],
        layout: Layout,
        problem: CalibrationProblem,
    ) -> None:
        """Begin with nothing known.

        Args:
            parts: Of each experiment the model that watches its states, and its own problem.
            layout: How rows become one.
            problem: The problem of all experiments.
        """
        first = parts[0][0]
        super().__init__(first.signals, first.seen, problem)
        self._parts = [LearnedODE(model.signals, model.seen, own) for model, own in parts]
        self._layout = layout

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
        for one, part in zip(self._layout.experiments, self._parts, strict=True):
            is_out[one.parameters] &= part.left_out
        return is_out if self.is_learnt else np.zeros_like(is_out)

    def unseen(self, u: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
        """Return points where an experiment's equations may act that no row has shown, see `LearnedODE`."""
        by_experiment = []
        for one, part in zip(self._layout.experiments, self._parts, strict=True):
            points = np.tile(u, (n, 1))
            points[:, one.parameters] = part.unseen(u[one.parameters], n, rng)
            by_experiment.append(points)
        # The first of each experiment, then the second ones.
        return np.concatenate(np.stack(by_experiment, axis=1))[:n]

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked, each experiment from its part."""
        self.n_asked += self.predicted is not None
        for one, part in zip(self._layout.experiments, self._parts, strict=True):
            part.predicted = self.predicted
            part.note(self._of(one, part._problem, answer))
        good = np.isfinite(answer.mse)
        self._u = np.concatenate([self._u, answer.u[good]])
        self._answered = np.concatenate([self._answered, answer.residuals[good]])
        self.predicted = None
        self.misfit = max(part.misfit for part in self._parts)
        lacking = [
            f"experiment {one.name}: {part.why_not}"
            for one, part in zip(self._layout.experiments, self._parts, strict=True)
            if not part.is_learnt
        ]
        self.why_not = next(iter(lacking), "")

    def _of(self, one: Experiment, problem: CalibrationProblem, answer: Evaluation) -> Evaluation:
        """Return what rows are in one experiment."""
        y = np.ascontiguousarray(answer.y[:, : one.n_times, one.outputs])
        residuals = problem.measurement.compared(y)
        mse = np.where(np.isfinite(answer.mse), np.mean(residuals**2, axis=1), np.inf)
        return Evaluation(
            answer.u[:, one.parameters],
            self._layout.theta_of(one, answer.theta),
            y,
            residuals,
            mse,
            mse,
            answer.failures,
        )

    def _residuals(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Return the residuals (n, m), those after the first outputs as if the rest were zero."""
        measurement = self._problem.measurement
        y = np.zeros((len(u), len(measurement.time), len(measurement.output_names)))
        with np.errstate(all="ignore"):
            for one, part in zip(self._layout.experiments, self._parts, strict=True):
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
        (one.parameter_space, more.settings.output_names, more.scenario.time, StateSignals.of(one))
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
    parts = [
        (part, CalibrationProblem(part, one.measurement))
        for part, one in zip(model.parts, case.experiments, strict=True)
    ]
    return ExperimentsODE(parts, case.layout, problem)
