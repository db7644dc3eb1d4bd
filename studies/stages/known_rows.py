"""Which stored simulations a stage knows from the beginning: the same ones when it goes on."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.partly_fixed import PartlyFixedModel
from simulation.states import WatchedModel
from simulation.store.store import SimulationStore
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.stages.calibrate import write_arrays
from studies.stages.results import read_arrays
from studies.uncertainty.rows import telling_rows

Worth = Callable[[Evaluation], FloatArray]
"""How much rows are worth, the best the most. Shape (n,)."""

ChooseRows = Callable[[SimulationStore, PartlyFixedModel, CalibrationProblem, Worth], FloatArray]
"""Which sets of the free parameters a stage knows beforehand. Shape (n, k). [per parameter]"""


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
        self, store: SimulationStore, model: PartlyFixedModel, problem: CalibrationProblem, worth: Worth
    ) -> FloatArray:
        """Return the rows that were noted, else choose and note them.

        They are chosen of those alone that lie in the box and have the fixed parameters at their values.

        Args:
            store: All simulations.
            model: What the problem is posed to: it knows what is fixed.
            problem: The problem of the free parameters.
            worth: How much rows are worth.

        Returns:
            Shape (n, k). [per parameter]
        """
        if self.file.is_file() and not self.anew:
            kept = read_arrays(self.file)
            if str(kept["digest"]) == self.digest and store.find(model.complete(kept["theta"])).all():
                return np.asarray(kept["theta"], dtype=np.float64)
        theta = fitting_theta(store, model)
        values = np.empty(0)
        for block in store.stream(model.complete(theta)):
            u = problem.space.to_unit(model.reduced(block.theta))
            answer = problem.model.reported(block) if isinstance(problem.model, WatchedModel) else block
            values = np.append(values, worth(problem.judge(u, answer)))
        # Rows of one worth are told apart by their parameters, not by where they happen to lie in the store.
        order = np.lexsort((*theta.T[::-1], -values))
        theta = theta[order]
        theta = theta[self.choose(problem.space.to_unit(theta), values[order])]
        write_arrays(self.file, {"digest": self.digest, "theta": theta})
        return np.asarray(theta, dtype=np.float64)


def fitting_theta(store: SimulationStore, model: PartlyFixedModel) -> FloatArray:
    """Return the stored rows in the box that have fixed parameters at their values. Shape (n, k)."""
    full = store.theta
    theta = model.reduced(full[model.holds(full)])
    return theta[model.parameter_space.contains(theta)]
