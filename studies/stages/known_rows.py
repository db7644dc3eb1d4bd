"""Which stored simulations a stage knows from the beginning: the same ones when it goes on."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.partly_fixed import PartlyFixedModel
from studies.stages.calibrate import write_arrays
from studies.stages.results import read_arrays
from studies.uncertainty.rows import telling_rows
from studies.watched_model import StoredWatchedModel

Worth = Callable[[Evaluation], FloatArray]
"""How much rows are worth, the best the most. Shape (n,)."""


class Known(NamedTuple):
    """Rows that a stage knows beforehand.

    Attributes:
        theta: Sets of the free parameters. Shape (n, k). [per parameter]
        watched: Which of them are stored with what the model's states did. Shape (n,).
    """

    theta: FloatArray
    watched: BoolArray


ChooseRows = Callable[[StoredModel, PartlyFixedModel, CalibrationProblem, Worth], Known]
"""Which rows a stage knows beforehand, of all that a model has stored."""


@dataclass(frozen=True)
class KnownRows:
    """The stored rows that tell most of the optimum, noted when the stage first begins.

    Attributes:
        file: Where they are noted.
        digest: Of what the stage is given.
        choose: Returns those that tell most of rows (n, k) in the unit cube and their worth (n,).
        anew: Whether they are chosen although they were noted.
    """

    file: Path
    digest: str
    choose: Callable[[FloatArray, FloatArray], IntArray] = telling_rows
    anew: bool = False

    def __call__(
        self, physical: StoredModel, model: PartlyFixedModel, problem: CalibrationProblem, worth: Worth
    ) -> Known:
        """Read the rows that were noted, else choose and note them.

        They are chosen of those alone that lie in the box and have the fixed parameters at their values.

        Args:
            physical: The model with all its simulations.
            model: What the problem is posed to: it knows what is fixed.
            problem: The problem of the free parameters.
            worth: How much rows are worth.
        """
        noted = self._noted(physical, model)
        if noted is not None:
            return noted
        theta = fitting_theta(physical.store, model)
        values = np.empty(0)
        for block in physical.store.stream(model.complete(theta)):
            u = problem.space.to_unit(model.reduced(block.theta))
            values = np.append(values, worth(problem.judge(u, block)))
        # Rows of one worth are told apart by their parameters, not by where they happen to lie in the store.
        order = np.lexsort((*theta.T[::-1], -values))
        theta = theta[order]
        theta = theta[self.choose(problem.space.to_unit(theta), values[order])]
        known = Known(np.asarray(theta, dtype=np.float64), physical.watched(model.complete(theta)))
        write_arrays(self.file, {"digest": self.digest, **known._asdict()})
        return known

    def _noted(self, physical: StoredModel, model: PartlyFixedModel) -> Known | None:
        """Return the rows that were noted, None where there are none, or some are lost."""
        if self.anew or not self.file.is_file():
            return None
        kept = read_arrays(self.file)
        theta = np.asarray(kept["theta"], dtype=np.float64)
        watched = np.asarray(kept.get("watched", np.zeros(len(theta))), dtype=np.bool_)
        if str(kept["digest"]) != self.digest:
            return None
        full = model.complete(theta)
        is_whole = physical.store.find(full).all() and physical.watched(full[watched]).all()
        return Known(theta, watched) if is_whole else None


def judge_known(
    problem: CalibrationProblem, physical: StoredModel, model: PartlyFixedModel, known: Known
) -> Evaluation:
    """Return how good known rows are, of a model that watches states with what these did.

    Args:
        problem: The problem of the free parameters.
        physical: The model with all its simulations.
        model: The same, asked the free parameters alone.
        known: The rows.
    """
    theta = model.complete(known.theta)
    if isinstance(physical, StoredWatchedModel):
        answer = physical.known(theta, known.watched)
    else:
        answer = physical.simulate(theta)
    return problem.judge(problem.space.to_unit(known.theta), model.of_free(answer))


def fitting_theta(store: SimulationStore, model: PartlyFixedModel) -> FloatArray:
    """Return the stored rows in the box that have fixed parameters at their values. Shape (n, k)."""
    full = store.theta
    theta = model.reduced(full[model.holds(full)])
    return theta[model.parameter_space.contains(theta)]
