"""A calibrated model as its judges ask it: what was simulated, its noise, and its state equations."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.store.stored_model import StoredModel
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.search.first_design import first_points
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.equation_model import EquationExperiments, EquationModel
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.uncertainty.density import Posterior
from studies.calibration.uncertainty.noise import Noise, NoiseKind, noise_of
from studies.physical_model import open_physical_model, open_watched_model
from studies.reporting.sentences import FITS_BETTER
from studies.results.outcome import Outcome
from studies.results.stage_results import Calibration
from studies.stages.adaptive_stage import learned_ode_of
from studies.stages.knowledge import prior_of
from studies.stages.warm_start import StartRows, WarmStart
from studies.task import Task


@dataclass(frozen=True, eq=False)
class JudgedModel:
    """A calibrated model and what is known of it.

    Attributes:
        physical: The model with its simulations.
        problem: The problem, posed to it.
        y: What it answered at the calibrated point. Shape (t, k). [per output]
        best_y: The same of the best row that is known. Shape (t, k). [per output]
        noise: What the residuals are taken for.
        rows: The stored rows that are known.
        known: What the model answered to them.
        ode: What learnt its state equations; None where the calibration believes in none.
    """

    physical: StoredModel
    problem: CalibrationProblem
    y: FloatArray
    best_y: FloatArray
    noise: Noise
    rows: StartRows
    known: Evaluation
    ode: LearnedODE | None

    @property
    def emulator(self) -> EquationModel | EquationExperiments | None:
        """The state equations, None where they are not known exactly."""
        return None if self.ode is None else self.ode.model


@contextmanager
def judged_model(
    task: Task, calibration: Outcome[Calibration], start: WarmStart, kind: NoiseKind
) -> Iterator[JudgedModel]:
    """Open the model of a calibration, with what its simulations say.

    Args:
        task: The study.
        calibration: The calibration.
        start: Which stored simulations are read.
        kind: Model of the noise.

    Yields:
        The model and what is known of it.
    """
    case, theta, prior = task.case, calibration.result.point, prior_of(task.case)
    measurement, n_parameters = case.measurement, case.parameter_space.n_parameters
    has_equations = calibration.result.believes_equations
    with open_watched_model(task) if has_equations else open_physical_model(task) as physical:
        problem = CalibrationProblem(physical, measurement, prior, case.layout)
        y = best_y = physical.simulate(theta[None]).y[0]
        noise = noise_of(kind, measurement, y, n_parameters)
        posterior = Posterior(noise, prior)
        rows = start(physical, problem, lambda found: posterior.at(found.u, found.mse))
        known = rows.judged(physical, problem)
        learned_ode = learned_ode_of(task.case, physical, problem)
        if learned_ode is not None and known.n:
            if known.n < LEAST_TO_LEARN:
                # What the calibration simulated in single experiments is stored there.
                n_first = Adaptive.design_size(problem.n_acting)
                rng = np.random.default_rng(task.profile.seed)
                learned_ode.learn_alone(first_points(n_first, n_parameters, rng))
            learned_ode.note(known)
        if known.n and known.mse.min() < FITS_BETTER * float(measurement.mse(y[None])[0]):
            # What a calibration that ended early has left over is not noise.
            best_y = known.y[np.argmin(known.mse)]
            noise = noise_of(kind, measurement, best_y, n_parameters)
        yield JudgedModel(physical, problem, y, best_y, noise, rows, known, learned_ode)
