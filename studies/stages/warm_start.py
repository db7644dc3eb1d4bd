"""The stored simulations that a stage starts from: the same ones when it goes on."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case
from simulation.store.stored_model import StoredModel
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.paths import ProjectPaths
from studies.physical_model import StoredWatchedModel, checked_file
from studies.results.saved import read_arrays, write_arrays

Worth = Callable[[Evaluation], FloatArray]
"""How much rows are worth, the best the most. Shape (n,)."""


class StartRows(NamedTuple):
    """Stored rows that a stage starts from.

    Attributes:
        theta: Parameter sets. Shape (n, p). [per parameter]
        watched: Which of them are stored with the model's states. Shape (n,).
    """

    theta: FloatArray
    watched: BoolArray

    def judged(self, physical: StoredModel, problem: CalibrationProblem) -> Evaluation:
        """Return how good they are; a model that watches states also reads what these did."""
        if isinstance(physical, StoredWatchedModel):
            answer = physical.known(self.theta, self.watched)
        else:
            answer = physical.simulate(self.theta)
        return problem.judge(problem.space.to_unit(self.theta), answer)


ChooseRows = Callable[[StoredModel, CalibrationProblem, Worth], StartRows]
"""Which rows a stage starts from, of all that a model has stored."""


def stored_in_box(physical: StoredModel) -> FloatArray:
    """Return the stored rows within the bounds. Shape (n, p). [per parameter]."""
    theta = physical.store.theta
    return theta[physical.parameter_space.contains(theta)]


@dataclass(frozen=True)
class WarmStart:
    """Chooses the stored rows to start from when a stage first begins, and notes them.

    Attributes:
        file: Where they are noted.
        digest: Of the stage's inputs.
        choose: Returns the most informative rows of (n, p) points in the unit cube with their worth (n,).
        rows: Returns the stored rows to choose from. Shape (n, p). [per parameter]
        anew: Whether they are chosen although they were noted.
    """

    file: Path
    digest: str
    choose: Callable[[FloatArray, FloatArray], IntArray]
    rows: Callable[[StoredModel], FloatArray] = stored_in_box
    anew: bool = False

    def __call__(self, physical: StoredModel, problem: CalibrationProblem, worth: Worth) -> StartRows:
        """Read the rows that were noted, else choose from the stored ones, and note them.

        Args:
            physical: The model with all its simulations.
            problem: The problem.
            worth: How much rows are worth.
        """
        noted = self._noted(physical)
        if noted is not None:
            return noted
        theta = self.rows(physical)
        values = np.empty(0)
        for block in physical.store.stream(theta):
            values = np.append(values, worth(problem.judge(problem.space.to_unit(block.theta), block)))
        # Rows of one worth are ordered by their parameters, not by where they happen to lie in the store.
        order = np.lexsort((*theta.T[::-1], -values))
        theta = theta[order]
        theta = theta[self.choose(problem.space.to_unit(theta), values[order])]
        rows = StartRows(theta, physical.watched(theta))
        write_arrays(self.file, {"digest": self.digest, **rows._asdict()})
        return rows

    def _noted(self, physical: StoredModel) -> StartRows | None:
        """Return the rows that were noted, None where there are none, or some are lost."""
        if self.anew or not self.file.is_file():
            return None
        kept = read_arrays(self.file)
        if str(kept["digest"]) != self.digest:
            return None
        rows = StartRows(kept["theta"], kept["watched"])
        is_whole = physical.store.find(rows.theta).all() and physical.watched(rows.theta[rows.watched]).all()
        return rows if is_whole else None


def checked_in_box(paths: ProjectPaths, case: Case) -> Callable[[StoredModel], FloatArray]:
    """Return what reads the stored rows within the bounds that a check of the case made.

    Args:
        paths: Of the project.
        case: The case. Rows of several experiments are stored apart, so these have none.
    """

    def read(physical: StoredModel) -> FloatArray:
        file, nothing = checked_file(paths, case), np.empty((0, physical.parameter_space.n_parameters))
        theta = read_arrays(file).get("theta", nothing) if file.is_file() else nothing
        if theta.shape[1:] != nothing.shape[1:] or not len(theta):
            return nothing
        return theta[physical.parameter_space.contains(theta) & physical.store.find(theta)]

    return read
