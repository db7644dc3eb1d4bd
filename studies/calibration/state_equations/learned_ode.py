"""State equations learnt during a calibration: they are fitted to its rows and propose the next point.

The equations are believed while the solved rows agree with the simulated ones; else the search goes on
without them, until they agree again. They are sure where rows agree so closely that more of them would add
nothing. Experiments of one model have equations each, and residuals that are minimized together.
"""

import math
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import InputError
from studies.calibration.box_newton import SAME_POINT, Expansion
from studies.calibration.descent import Descents, descend_together, jacobians, objectives
from studies.calibration.growing_rows import GrowingRows
from studies.calibration.largest_samples import outlying_part
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_equations.belief import squared_differences
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.equation_model import EquationExperiments, EquationModel
from studies.calibration.state_equations.learner import EquationLearner
from studies.calibration.state_equations.states import WatchedModel
from studies.calibration.state_equations.terms import TINY

# Rows after which equations are taken though some coefficient is no formula, by parameter and at least.
# With 14 rows at first, 14 parameters took 16 calls to 1.02 times instead of 12;
# with 8 rows, up to 31 (docs/notes/state-equations.md, First form).
PER_PARAMETER, LEAST_ROWS = 2.0 / 3.0, 6

# Random points that are looked at, and how many of the best of them are walked downhill.
N_LOOKS, N_WALKS = 400, 20
# Where a solution takes more operations than this (the office's takes 3.4e5, 0.2 ms), there are fewer looks
# and walks. Of stiff equations whose solution takes 10 ms, all of them took two minutes a call.
CHEAP = 4e5
# Parts of the time that walks of equations with switches fit first, one after the other.
# Of 16 such searches all ended at the least error (docs/notes/state-equations.md, Switches).
PARTS_OF_TIME = (1 / 16, 1 / 8, 1 / 4, 1 / 2)
# How far beside a point that is known another one is drawn. By hand. [1]
BESIDE_KNOWN = 0.02

LEAST_CALLS = LEAST_TO_LEARN + 1
"""The rows that the simplest equations are learnt from, and the best point that these expect."""


def enough_for_equations(n_parameters: int) -> int:
    """Return how many rows of a first design state equations take at most."""
    return max(math.ceil(PER_PARAMETER * n_parameters), LEAST_ROWS)


class LearnedODE:
    """The state equations of a calibration problem, as far as its rows show them.

    Attributes:
        experiments: The equations of each, all of them or the only one.
        predicted: The objective that was expected of the point proposed last, None once it is known or
            forgotten. [unit squared]
        n_asked: Proposed points that were simulated.
        n_alone: Simulations of single experiments.
        is_given_up: Whether the search goes on without them.
    """

    def __init__(
        self,
        experiments: Sequence[EquationLearner],
        problem: CalibrationProblem,
        alone: Callable[[FloatArray], int] = lambda u: 0,
    ) -> None:
        """Begin with nothing known.

        Args:
            experiments: The equations of each of the problem's experiments.
            problem: The problem.
            alone: Learns from single experiments at points (n, p) of the first design, and returns how many
                simulations of single ones there were.
        """
        self.experiments, self._problem, self._alone = experiments, problem, alone
        self._descents = Descents(problem.prior, problem.space.n_parameters, N_WALKS)
        self._u = np.empty((0, problem.space.n_parameters))
        self._answers = GrowingRows(problem.measurement.n_samples)
        self.predicted: float | None = None
        self.n_asked = self.n_alone = 0
        self.is_given_up = False

    @classmethod
    def of(cls, problem: CalibrationProblem) -> Self:
        """Return what learns the equations of a problem that is posed to a model that watches its states.

        Raises:
            InputError: It is posed to another model.
        """
        model = problem.model
        if not isinstance(model, WatchedModel):
            raise InputError(
                f"state equations need a WatchedModel, not {type(model).__name__}; see calibration.states"
            )
        return cls([EquationLearner(model.signals, model.seen, problem)], problem)

    @property
    def is_believed(self) -> bool:
        """Whether all equations do what the rows do, and have not led to failures."""
        return all(experiment.is_believed for experiment in self.experiments)

    @property
    def is_sure(self) -> bool:
        """Whether all equations match what was simulated: more rows would add nothing."""
        return all(experiment.is_sure for experiment in self.experiments)

    @property
    def is_learnt(self) -> bool:
        """Whether all experiments have equations, believed or not."""
        return all(experiment.equations is not None for experiment in self.experiments)

    @property
    def model(self) -> EquationModel | EquationExperiments | None:
        """A model that answers by the equations, None where they are not known exactly."""
        models = [
            EquationModel(experiment.equations, experiment.problem.space, experiment.problem.model.time)
            for experiment in self.experiments
            if experiment.equations is not None and experiment.is_sure
        ]
        if len(models) < len(self.experiments):
            return None
        layout, space = self._problem.layout, self._problem.space
        return models[0] if layout is None else EquationExperiments(models, layout, space)

    @property
    def n_states(self) -> int:
        """States whose equations it learns, without positions of switches."""
        return self.experiments[0].known.signals.n_continuous

    @property
    def hidden_inputs(self) -> tuple[str, ...]:
        """Names of the variables of the FMU that the equations take as inputs beside the declared ones."""
        used = [
            experiment.equations.signals
            for experiment in self.experiments
            if experiment.equations is not None
        ]
        return tuple(dict.fromkeys(name for signals in used for name in signals.inputs[signals.n_declared :]))

    @property
    def misfit(self) -> float:
        """Greatest share of squares that the terms of a derivative or an output leave. [1]."""
        return max(experiment.known.misfit for experiment in self.experiments)

    @property
    def why_not(self) -> str:
        """Why there are no equations, in words."""
        lacking = (experiment for experiment in self.experiments if experiment.equations is None)
        named = (f"experiment {experiment.name}: {experiment.known.why_not}" for experiment in lacking)
        return self.experiments[0].known.why_not if self._problem.layout is None else next(named, "")

    @property
    def error_at_best(self) -> float:
        """How solved equations differ from the best simulation, as a share of its squared residuals. [1]."""
        answered = self._answers.rows
        mse = np.mean(answered**2, axis=1)
        best = int(np.argmin(mse))
        error = squared_differences(self._residuals(self._u[[best]]), answered[[best]])[0]
        rest = mse[best] - outlying_part(answered[best], float(self._problem.measurement.uncertainty[0]))
        share = float(error / (rest + TINY))
        return share if np.isfinite(share) else np.inf

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of the parameters that are in none of the equations that it believes."""
        names = self._problem.space.names
        return tuple(name for name, out in zip(names, self.left_out, strict=True) if out and self.is_sure)

    @property
    def left_out(self) -> BoolArray:
        """Which parameters are in no equation: what they do, as where a weir begins, no row has shown."""
        is_out = np.full(self._problem.space.n_parameters, self.is_learnt)
        for experiment in self.experiments:
            is_out[experiment.parameters] &= experiment.left_out
        return is_out

    def unseen(self, u: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
        """Return points where equations may act that no row has shown.

        These are a point with all that is left out at either end of its range, and points where states go
        farthest beyond what any row has shown, by the equations.

        Args:
            u: The point. Shape (p,). [1]
            n: How many are returned.
            rng: Source of the points that are compared.

        Returns:
            Shape (n, p). [1]
        """
        points = np.tile(u, (n, len(self.experiments), 1))
        for place, experiment in enumerate(self.experiments):
            points[:, place, experiment.parameters] = experiment.unseen(u[experiment.parameters], n, rng)
        # The first of each experiment, then the second ones.
        return points.reshape(-1, len(u))[:n]

    def slopes(self, u: FloatArray) -> FloatArray:
        """Return the residuals' slopes at a point by the equations. Shape (m, p). [unit per range].

        Args:
            u: The point. Shape (p,). [1]
        """
        return np.asarray(jacobians(self._residuals, u[None], self._residuals(u[None]))[0])

    def report_to(self, think_of: Callable[[str], None]) -> None:
        """Call this from now on with what is looked at, as that may take seconds."""
        for experiment in self.experiments:
            experiment.known.think_of = think_of

    def learn_alone(self, u: FloatArray) -> int:
        """Learn from rows that cost less than a whole one, as those of single experiments do.

        Args:
            u: Points of the first design. Shape (n, p). [1]

        Returns:
            How many whole rows they are worth, rounded up.
        """
        self.n_alone = self._alone(u)
        return math.ceil(self.n_alone / len(self.experiments))

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked, each experiment from its part.

        Args:
            answer: The rows; failed ones teach nothing.
        """
        is_proposed = self.predicted is not None
        self.n_asked += is_proposed
        self.predicted = None
        if self._problem.layout is None:
            self.experiments[0].note(answer, is_proposed=is_proposed)
            is_kept = self.experiments[0].rows.hold(answer.u)
        else:
            for experiment in self.experiments:
                experiment.note_part(answer, is_proposed=is_proposed)
            is_kept = np.isfinite(answer.mse)
        self._u = np.concatenate([self._u, answer.u[is_kept]])
        self._answers.add(answer.residuals[is_kept])

    def propose(
        self, objective: FloatArray, known: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, Expansion]:
        """Return the point to ask next, and what is expected of it.

        Args:
            objective: Of the rows so far, infinite where they failed. Shape (n,). [unit squared]
            known: Their points. Shape (n, p). [1]
            rng: Source of the points that are looked at.
        """
        self.experiments[0].known.think_of("optimum by the state equations")
        p = known.shape[1]
        looks = rng.random((N_LOOKS, p))
        # Not studied: switches in several experiments.
        if self._problem.layout is None and self.experiments[0].known.signals.n_switches:
            looks = np.concatenate([ends_of_parts(self._problem, self._residuals, rng), looks])
        rows = known[np.argsort(objective, kind="stable")]
        solutions = (one.equations.flow.n_operations for one in self.experiments if one.equations is not None)
        share = min(1.0, CHEAP / max(sum(solutions), 1.0))
        ends, values = self._descents.lowest(self._residuals, looks, rows, share=share)
        u, value = ends[0], float(values[0])
        distance = np.abs(known - u).max(axis=1)
        if distance.min(initial=np.inf) < SAME_POINT:
            nearest = int(np.argmin(distance))
            # That point is known; one a little beside adds more.
            if self.is_sure and np.isfinite(objective[nearest]):
                value = float(objective[nearest])
            u = np.clip(u + rng.uniform(-BESIDE_KNOWN, BESIDE_KNOWN, p), 0.0, 1.0)
        self.predicted = float(objectives(self._problem.prior, u[None], self._residuals(u[None]))[0])
        # With no curvature, points that are drawn beside this one spread alike in all directions.
        return u, Expansion.known(value, value, np.zeros(p), np.zeros((p, p)))

    @np.errstate(all="ignore")
    def _residuals(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Return the residuals (n, m), those after the first outputs as if the rest were zero."""
        measurement = self._problem.measurement
        y = np.zeros((len(u), len(measurement.time), len(measurement.output_names)))
        for experiment in self.experiments:
            outputs = experiment.solved(u[:, experiment.parameters], n_outputs)
            y[:, : outputs.shape[1], experiment.outputs] = outputs
        return measurement.compared(y)


def ends_of_parts(
    problem: CalibrationProblem, solved: Callable[[FloatArray, int], FloatArray], rng: np.random.Generator
) -> FloatArray:
    """Return where walks end that fit a part of the time, then twice as much and so on. Shape (w, p). [1].

    The error over the whole time jumps with the number of changes; over a short time there are few.

    Args:
        problem: The problem.
        solved: Points and a number of outputs to residuals by the equations, as if later ones were zero.
        rng: Source of the random points.
    """
    measurement, p = problem.measurement, problem.space.n_parameters
    ends = np.empty((0, p))
    for part in PARTS_OF_TIME:
        n = math.ceil(part * len(measurement.time))
        late = np.zeros((1, len(measurement.time), len(measurement.output_names)))
        late[:, n:] = 1.0
        is_seen = (measurement.compared(late) == measurement.compared(0.0 * late))[0]

        def residuals(u: FloatArray, n: int = n, is_seen: BoolArray = is_seen) -> FloatArray:
            return solved(u, n)[:, is_seen]

        starts = np.concatenate([ends, rng.random((N_LOOKS, p))])
        best = np.argsort(objectives(None, starts, residuals(starts)), kind="stable")[:N_WALKS]
        ends, _ = descend_together(residuals, problem.prior, starts[best])
    return ends
