"""State equations learnt during a calibration: they are fitted to its rows and propose the next point.

The equations are believed while the solved rows agree with the simulated ones; else the search goes on
without them, until they agree again. They are sure where rows agree so closely that more of them would add
nothing. Experiments of one model have equations each, and residuals that are minimized together.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.errors import InputError
from simulation.layout import Layout
from studies.calibration.box_newton import Expansion
from studies.calibration.descent import jacobians
from studies.calibration.growing_rows import GrowingRows
from studies.calibration.largest_samples import outlying_part
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_equations.belief import squared_differences
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.equation_model import EquationExperiments, EquationModel
from studies.calibration.state_equations.learner import EquationLearner
from studies.calibration.state_equations.optimum import Optimum
from studies.calibration.state_equations.states import WatchedModel

# Rows after which equations are taken though some coefficient is no formula, by parameter and at least.
# With 14 rows at first, 14 parameters took 16 calls to 1.02 times instead of 12;
# with 8 rows, up to 31 (docs/notes/state-equations.md, First form).
PER_PARAMETER, LEAST_ROWS = 2.0 / 3.0, 6

LEAST_CALLS = LEAST_TO_LEARN + 1
"""The rows that the simplest equations are learnt from, and the best point that these expect."""


def enough_for_equations(n_parameters: int) -> int:
    """Return how many rows of a first design state equations take at most."""
    return max(math.ceil(PER_PARAMETER * n_parameters), LEAST_ROWS)


class Part(NamedTuple):
    """An experiment's equations, and where what belongs to it stands among what belongs to all.

    Attributes:
        name: Its name.
        parameters: Columns of its parameters.
        outputs: Columns of its outputs.
        n_times: How many of the output times it has, from the first on.
        learner: Learns them.
    """

    name: str
    parameters: IntArray | slice
    outputs: IntArray | slice
    n_times: int
    learner: EquationLearner


class LearnedODE:
    """The state equations of a calibration problem, as far as its rows show them.

    Attributes:
        parts: Of every experiment.
        predicted: The objective that was expected of the point proposed last, None once it is known or
            forgotten. [unit squared]
        n_asked: Proposed points that were simulated.
        n_alone: Simulations of single experiments.
        is_given_up: Whether the search goes on without them.
    """

    def __init__(
        self,
        learners: Sequence[EquationLearner],
        problem: CalibrationProblem,
        layout: Layout | None = None,
        alone: Callable[[FloatArray], int] = lambda u: 0,
    ) -> None:
        """Begin with nothing known.

        Args:
            learners: One for every experiment.
            problem: The problem.
            layout: How rows of several experiments become one, None for a single one.
            alone: Learns from single experiments at points of the first design, and returns how many
                simulations these took.
        """
        whole = slice(None)
        self.parts = (
            [Part("", whole, whole, len(problem.measurement.time), *learners)]
            if layout is None
            else [
                Part(one.name, one.parameters, one.outputs, one.n_times, learner)
                for one, learner in zip(layout.experiments, learners, strict=True)
            ]
        )
        self._problem, self._layout, self._alone = problem, layout, alone
        self._optimum = Optimum(problem, self._residuals)
        self._u = np.empty((0, problem.space.n_parameters))
        self._answers = GrowingRows(problem.measurement.n_samples)
        self._think_of: Callable[[str], None] = lambda subject: None
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
    def _learners(self) -> list[EquationLearner]:
        return [part.learner for part in self.parts]

    @property
    def is_believed(self) -> bool:
        """Whether all equations do what the rows do, and have not led to failures."""
        return all(one.is_believed for one in self._learners)

    @property
    def is_sure(self) -> bool:
        """Whether all equations match what was simulated: more rows would add nothing."""
        return all(one.is_sure for one in self._learners)

    @property
    def is_learnt(self) -> bool:
        """Whether all experiments have equations, believed or not."""
        return all(one.equations is not None for one in self._learners)

    @property
    def model(self) -> EquationModel | EquationExperiments | None:
        """A model that answers by the equations, None where they are not known exactly."""
        models = [model for one in self._learners if (model := one.model) is not None]
        if len(models) < len(self.parts):
            return None
        if self._layout is None:
            return models[0]
        return EquationExperiments(models, self._layout, self._problem.space)

    @property
    def n_states(self) -> int:
        """States whose equations it learns, without positions of switches."""
        return self.parts[0].learner.known.signals.n_continuous

    @property
    def hidden_inputs(self) -> tuple[str, ...]:
        """Names of the variables of the FMU that the equations take as inputs beside the declared ones."""
        return tuple(dict.fromkeys(name for one in self._learners for name in one.hidden_inputs))

    @property
    def misfit(self) -> float:
        """Greatest share of squares that the terms of a derivative or an output leave. [1]."""
        return max(one.known.misfit for one in self._learners)

    @property
    def why_not(self) -> str:
        """Why there are no equations, in words."""
        if self._layout is None:
            return self.parts[0].learner.known.why_not
        lacking = (part for part in self.parts if part.learner.equations is None)
        return next((f"experiment {part.name}: {part.learner.known.why_not}" for part in lacking), "")

    @property
    def error_at_best(self) -> float:
        """How solved equations differ from the best simulation, as a share of its squared residuals. [1]."""
        answered = self._answers.rows
        mse = np.mean(answered**2, axis=1)
        best = int(np.argmin(mse))
        error = squared_differences(self._residuals(self._u[[best]]), answered[[best]])[0]
        rest = mse[best] - outlying_part(answered[best], float(self._problem.measurement.uncertainty[0]))
        share = float(error / (rest + np.finfo(float).tiny))
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
        for part in self.parts:
            is_out[part.parameters] &= part.learner.left_out
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
        points = np.tile(u, (n, len(self.parts), 1))
        for place, part in enumerate(self.parts):
            points[:, place, part.parameters] = part.learner.unseen(u[part.parameters], n, rng)
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
        self._think_of = think_of
        for one in self._learners:
            one.known.think_of = think_of

    def learn_alone(self, u: FloatArray) -> int:
        """Learn from rows that cost less than a whole one, as those of single experiments do.

        Args:
            u: Points of the first design. Shape (n, p). [1]

        Returns:
            How many whole rows they are worth, rounded up.
        """
        self.n_alone += self._alone(u)
        return math.ceil(self.n_alone / len(self.parts))

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked, each experiment from its part.

        Args:
            answer: The rows; failed ones teach nothing.
        """
        is_proposed = self.predicted is not None
        self.n_asked += is_proposed
        self.predicted = None
        if self._layout is None:
            learner = self.parts[0].learner
            learner.note(answer, is_proposed=is_proposed)
            is_kept = learner.rows.hold(answer.u)
        else:
            for part in self.parts:
                # What was simulated alone is no news in a whole row.
                is_new = ~part.learner.rows.hold(answer.u[:, part.parameters])
                if is_new.any():
                    own = _in_experiment(part, answer, np.flatnonzero(is_new))
                    part.learner.note(own, is_proposed=is_proposed)
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
        self._think_of("optimum by the state equations")
        # Not studied: switches in several experiments.
        has_switches = self._layout is None and self.parts[0].learner.known.signals.n_switches > 0
        u, value = self._optimum.point(objective, known, rng, has_switches=has_switches, is_sure=self.is_sure)
        self.predicted = self._optimum.expected(u)
        # With no curvature, points that are drawn beside this one spread alike in all directions.
        return u, Expansion.known(value, value, np.zeros(len(u)), np.zeros((len(u), len(u))))

    @np.errstate(all="ignore")
    def _residuals(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Return the residuals (n, m), those after the first outputs as if the rest were zero."""
        measurement = self._problem.measurement
        y = np.zeros((len(u), len(measurement.time), len(measurement.output_names)))
        for part in self.parts:
            n = part.n_times if n_outputs is None else n_outputs
            y[:, :n, part.outputs] = part.learner.outputs(u[:, part.parameters], n_outputs)
        return measurement.compared(y)


def _in_experiment(part: Part, answer: Evaluation, rows: IntArray) -> Evaluation:
    """Return what some rows are in one experiment."""
    y = np.ascontiguousarray(answer.y[rows, : part.n_times][..., part.outputs])
    residuals = part.learner.problem.measurement.compared(y)
    mse = np.where(np.isfinite(answer.mse[rows]), np.mean(residuals**2, axis=1), np.inf)
    u, theta = (np.ascontiguousarray(values[rows][:, part.parameters]) for values in (answer.u, answer.theta))
    return Evaluation(u, theta, y, residuals, mse, mse, tuple(answer.failures[row] for row in rows))
