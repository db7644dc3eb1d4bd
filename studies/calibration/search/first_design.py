"""The first rows of a calibration: a Latin hypercube, the most spread out of many."""

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.search.constants import SEARCH
from studies.calibration.search.restart import inside

# Latin hypercubes that are compared; by hand.
N_DESIGNS = 200


def first_points(n: int, p: int, rng: np.random.Generator) -> FloatArray:
    """Return what an adaptive calibration begins with, away from the edges of the box. Shape (n, p). [1]."""
    return np.round(inside(latin_hypercube(n, p, rng)), SEARCH.decimals)


def latin_hypercube(n: int, p: int, rng: np.random.Generator) -> FloatArray:
    """Return the most spread out of many Latin hypercube samples. Shape (n, p). [1]."""
    chosen, widest = np.empty((n, p)), -1.0
    for _ in range(N_DESIGNS):
        cells = rng.permuted(np.tile(np.arange(n), (p, 1)), axis=1).T
        u = (cells + rng.random((n, p))) / n
        distances = ((u[:, None] - u[None]) ** 2).sum(axis=2)
        # Maximin distance (Johnson, Moore and Ylvisaker 1990, doi:10.1016/0378-3758(90)90122-B).
        least = float(distances[~np.eye(n, dtype=np.bool_)].min(initial=np.inf))
        if least > widest:
            chosen, widest = u, least
    return chosen
