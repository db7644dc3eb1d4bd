"""The first rows of a calibration: a Latin hypercube, the most spread out of many."""

import numpy as np

from simulation.arrays import FloatArray

# Decimals of the unit cube to which points are rounded: should the last bits of the linear algebra
# differ, the points do not, and a store finds their simulations again.
DECIMALS = 5
# Part of each coordinate's range that the first design and random places leave out at both ends. By hand.
MARGIN = 0.15

# Latin hypercubes that are compared; by hand.
N_DESIGNS = 200


def first_points(n: int, p: int, rng: np.random.Generator) -> FloatArray:
    """Return what an adaptive calibration begins with, away from the bounds. Shape (n, p). [1]."""
    return np.round(inside(latin_hypercube(n, p, rng)), DECIMALS)


def inside(u: FloatArray) -> FloatArray:
    """Return points of the unit cube moved into the part of it that a margin leaves."""
    return MARGIN + (1.0 - 2.0 * MARGIN) * u


def within(centre: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper bounds within a half width of a point (p,) of the unit cube. Shapes (p,)."""
    return np.maximum(centre - radius, 0.0), np.minimum(centre + radius, 1.0)


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
