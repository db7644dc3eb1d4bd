"""Which parameter rows to simulate: designs over the whole box, nested in their size."""

from collections.abc import Iterable

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.parameters import ParameterSpace

_MOST_DRAWN = 1_000_000


def uniform_design(space: ParameterSpace, n: int, seed: int) -> FloatArray:
    """Sample the box uniformly in physical units, as the paper does (Eq. 2).

    A design is nested: the rows of a smaller design are the first rows of a larger one of the same seed.

    Args:
        space: The box.
        n: Number of rows.
        seed: Seed of the draw.

    Returns:
        Parameters. Shape (n, p). [per parameter]
    """
    return spread_design(space, n, 1.0, seed)


def spread_design(
    space: ParameterSpace, n: int, spread: float, seed: int, *, columns: Iterable[str] | None = None
) -> FloatArray:
    """Sample a box shrunk around the middle of the bounds (sec. 3.2).

    Args:
        space: The box.
        n: Number of rows; designs of one seed and spread are nested.
        spread: The paper's delta: fraction of the distance from the middle to the bounds, 0 to 1. [1]
        seed: Seed of the draw.
        columns: Names of the parameters that are shrunk; the others keep their bounds. None for all.

    Returns:
        Parameters. Shape (n, p). [per parameter]
    """
    chosen = space.names if columns is None else tuple(columns)
    shrink = np.where(np.isin(space.names, chosen), spread, 1.0)
    middle, reach = (space.lower + space.upper) / 2, (space.upper - space.lower) / 2
    rng, kept = np.random.default_rng(seed), [np.empty((0, space.n_parameters))]
    n_drawn, n_kept = 0, 0
    while n_kept < n:
        # Generator.random fills row by row, so a longer draw begins with the shorter one.
        draw = 2.0 * rng.random((n, space.n_parameters)) - 1.0
        theta = np.clip(middle + shrink * reach * draw, space.lower, space.upper)
        # Rows that break a constraint are left out, which leaves the others uniform.
        kept.append(theta[space.contains(theta)])
        n_drawn, n_kept = n_drawn + n, n_kept + len(kept[-1])
        if n_drawn > _MOST_DRAWN and n_kept < n:
            raise InputError(f"of {n_drawn:,} random rows, {n_kept} keep the constraints; narrow the bounds")
    return np.concatenate(kept)[:n]
