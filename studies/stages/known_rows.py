"""Which stored simulations an uncertainty knows from the beginning: the same ones when its stage goes on."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.partly_fixed import PartlyFixedModel
from simulation.store.store import SimulationStore
from studies.calibration.problem import CalibrationProblem
from studies.stages.calibrate import write_arrays
from studies.stages.results import read_arrays
from studies.uncertainty.density import Posterior
from studies.uncertainty.rows import telling_rows

ChooseRows = Callable[[SimulationStore, PartlyFixedModel, CalibrationProblem, Posterior], FloatArray]
"""Which sets of the free parameters the surrogate knows beforehand. Shape (n, k). [per parameter]"""


@dataclass(frozen=True)
class KnownRows:
    """The stored rows that tell most of the optimum, noted when the stage first begins.

    Attributes:
        file: Where they are noted.
        digest: Of what the stage is given.
    """

    file: Path
    digest: str

    def __call__(
        self,
        store: SimulationStore,
        model: PartlyFixedModel,
        problem: CalibrationProblem,
        posterior: Posterior,
    ) -> FloatArray:
        """Return the rows that were noted, else choose and note them. Shape (n, k). [per parameter]."""
        if self.file.is_file():
            kept = read_arrays(self.file)
            if str(kept["digest"]) == self.digest and store.find(model.complete(kept["theta"])).all():
                return np.asarray(kept["theta"], dtype=np.float64)
        theta = telling_theta(store, model, problem, posterior)
        write_arrays(self.file, {"digest": self.digest, "theta": theta})
        return theta


def telling_theta(
    store: SimulationStore, model: PartlyFixedModel, problem: CalibrationProblem, posterior: Posterior
) -> FloatArray:
    """Return the stored rows that tell most: of those alone that have the fixed parameters at their values.

    Args:
        store: All simulations.
        model: What the problem is posed to: it knows what is fixed.
        problem: The problem of the free parameters.
        posterior: Their density.

    Returns:
        Shape (n, k). [per parameter]
    """
    space, full = problem.space, store.theta
    full = full[model.holds(full)]
    full = full[space.contains(model.reduced(full))]
    theta, density = model.reduced(full), np.empty(0)
    for block in store.stream(full):
        u = space.to_unit(model.reduced(block.theta))
        density = np.append(density, posterior.at(u, problem.judge(u, block).mse))
    # Rows of one density are told apart by their parameters, not by where they happen to lie in the store.
    order = np.lexsort((*theta.T[::-1], -density))
    theta = theta[order]
    chosen: FloatArray = theta[telling_rows(space.to_unit(theta), density[order])]
    return chosen
