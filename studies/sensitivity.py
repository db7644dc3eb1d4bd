"""Sobol indices of every output at every time step; the only module that knows SALib."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from SALib.analyze.sobol import first_order as salib_first_order
from SALib.analyze.sobol import total_order as salib_total_order
from SALib.sample import sobol as salib_sobol
from scipy.stats import norm

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.streaming import streamed
from simulation.whole_file import whole_file

# An output that varies by less than this fraction of its size does not vary: float32 networks repeat to 1e-6.
CONSTANT = 1e-6
CHUNK = 2048
CONFIDENCE_LEVEL = 0.95

OnProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class SobolIndices:
    """How much of an output's variance each parameter explains, step by step.

    Where an output does not vary (or too few simulations succeeded) the indices are undefined and NaN.

    Attributes:
        time: Output times. Shape (t,). [s]
        names: Names of the p parameters.
        output_names: Names of the k outputs.
        first_order: Share that a parameter explains alone. Shape (t, k, p). [1]
        total_order: Share that it takes part in. Shape (t, k, p). [1]
        first_order_ci: Half width of the bootstrapped 95 % confidence interval. Shape (t, k, p). [1]
        total_order_ci: The same for the total order. Shape (t, k, p). [1]
        variance: Variance of the output over the box. Shape (t, k). [output's unit squared]
        n_base: Saltelli blocks asked for; each has p + 2 rows.
        n_dropped: Blocks left out because one of their rows failed.
        n_calls: Rows asked of the model.
    """

    time: FloatArray
    names: tuple[str, ...]
    output_names: tuple[str, ...]
    first_order: FloatArray
    total_order: FloatArray
    first_order_ci: FloatArray
    total_order_ci: FloatArray
    variance: FloatArray
    n_base: int
    n_dropped: int
    n_calls: int

    @property
    def undefined(self) -> BoolArray:
        """Steps at which an output does not vary. Shape (t, k)."""
        return np.isnan(self.total_order[:, :, 0])

    def mean_first_order(self) -> FloatArray:
        """Average the first-order indices over the steps where they are defined. Shape (k, p). [1]."""
        return _mean_over_time(self.first_order)

    def mean_total_order(self) -> FloatArray:
        """Average the total-order indices over the steps where they are defined. Shape (k, p). [1]."""
        return _mean_over_time(self.total_order)

    def order(self, output: int = 0) -> tuple[int, ...]:
        """Return the parameters' positions, most influential first by mean first order, as in Fig. 5."""
        mean = np.nan_to_num(self.mean_first_order()[output], nan=-np.inf)
        return tuple(int(i) for i in np.argsort(-mean, kind="stable"))

    def save(self, path: Path) -> None:
        """Write to an .npz file, old or new but never half of one."""
        content = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        with whole_file(Path(path)) as file:
            np.savez(file, allow_pickle=False, **content)

    @classmethod
    def load(cls, path: Path) -> "SobolIndices":
        """Read a file written by save().

        Raises:
            InputError: If the file is missing.
        """
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; run the sensitivity analysis first")
        with np.load(path, allow_pickle=False) as content:
            return cls(
                time=content["time"],
                names=tuple(str(name) for name in content["names"]),
                output_names=tuple(str(name) for name in content["output_names"]),
                first_order=content["first_order"],
                total_order=content["total_order"],
                first_order_ci=content["first_order_ci"],
                total_order_ci=content["total_order_ci"],
                variance=content["variance"],
                n_base=int(content["n_base"]),
                n_dropped=int(content["n_dropped"]),
                n_calls=int(content["n_calls"]),
            )


def sobol_indices(
    model: ForwardModel,
    *,
    n_base: int,
    seed: int,
    n_resamples: int = 100,
    on_progress: OnProgress | None = None,
) -> SobolIndices:
    """Estimate first- and total-order Sobol indices at every step (App. B; doi 10.1016/j.cpc.2009.09.018).

    Parameters vary uniformly between their bounds, as the training set does (Eq. 2), whatever their scale.

    Args:
        model: Model to ask; usually the surrogate, since it is asked n_base (p + 2) times.
        n_base: Saltelli blocks, a power of two.
        seed: Seed of the sample and of the bootstrap; 0 is a seed like any other.
        n_resamples: Bootstrap samples behind the confidence intervals.
        on_progress: Called with the rows done and their number in all.

    Returns:
        The indices. A block with a failed row is left out as a whole, since its rows belong together.

    Raises:
        InputError: If n_base is not a power of two.
    """
    if n_base < 2 or n_base & (n_base - 1):
        raise InputError(f"n_base is {n_base}; give a power of two, for example 512")
    if n_resamples < 2:
        raise InputError(f"n_resamples is {n_resamples}; give at least 2")
    space = model.parameter_space
    p = space.n_parameters
    declared = {
        "num_vars": p,
        "names": list(space.names),
        "bounds": np.column_stack([space.lower, space.upper]).tolist(),
    }
    theta = np.asarray(salib_sobol.sample(declared, n_base, calc_second_order=False, seed=seed))
    y = _simulate(model, theta, on_progress)
    blocks = y.reshape(n_base, p + 2, -1)
    blocks = blocks[np.isfinite(blocks).all(axis=(1, 2))]

    shape = (len(model.time), len(model.output_names))
    estimates = _estimate(blocks, np.random.default_rng(seed), n_resamples)
    first, total, first_ci, total_ci = (estimate.reshape(*shape, p) for estimate in estimates)
    variance = blocks[:, [0, -1]].reshape(-1, blocks.shape[2]).var(axis=0) if len(blocks) else np.nan
    return SobolIndices(
        time=np.asarray(model.time, dtype=np.float64),
        names=space.names,
        output_names=tuple(model.output_names),
        first_order=first,
        total_order=total,
        first_order_ci=first_ci,
        total_order_ci=total_ci,
        variance=np.broadcast_to(variance, shape[0] * shape[1]).reshape(shape).copy(),
        n_base=n_base,
        n_dropped=n_base - len(blocks),
        n_calls=len(theta),
    )


def _simulate(model: ForwardModel, theta: FloatArray, on_progress: OnProgress | None) -> FloatArray:
    """Ask the model block by block. Shape (n, t*k). [output's unit]."""

    def advance(n_done: int) -> None:
        if on_progress is not None:
            on_progress(n_done, len(theta))

    y = np.empty((len(theta), len(model.time) * len(model.output_names)))
    n_done = 0
    for block in streamed(model, theta, on_progress=advance, block_rows=CHUNK):
        y[n_done : n_done + block.n] = block.y.reshape(block.n, -1)
        n_done += block.n
    return y


def _estimate(
    blocks: FloatArray, rng: np.random.Generator, n_resamples: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Estimate first and total order and their confidence half widths for every column.

    Args:
        blocks: Rows A, AB_1 ... AB_p, B of every Saltelli block. Shape (n, p + 2, d). [output's unit]
        rng: Source of the bootstrap.
        n_resamples: Bootstrap samples.

    Returns:
        Four arrays of shape (d, p); NaN where a column does not vary.
    """
    n, p, d = len(blocks), blocks.shape[1] - 2, blocks.shape[2]
    result = np.full((4, d, p), np.nan)
    if n < 2:
        return result[0], result[1], result[2], result[3]
    size = np.abs(blocks).max(axis=(0, 1))
    varies = np.ptp(blocks, axis=(0, 1)) > CONSTANT * size
    if not varies.any():
        return result[0], result[1], result[2], result[3]
    # The first-order estimator is biased for outputs that are not centered, so SALib standardizes; so do we.
    z = blocks[:, :, varies]
    z = (z - z.mean(axis=(0, 1))) / z.std(axis=(0, 1))
    a, b = z[:, 0], z[:, -1]
    counts = _bootstrap_counts(rng, n, n_resamples)
    variance = counts @ (a**2 + b**2) / 2.0 - (counts @ (a + b) / 2.0) ** 2
    half_width = norm.ppf(0.5 + CONFIDENCE_LEVEL / 2.0)
    for j in range(p):
        ab = z[:, j + 1]
        result[0, varies, j] = salib_first_order(a, ab, b)
        result[1, varies, j] = salib_total_order(a, ab, b)
        first = _share(counts @ (b * (ab - a)), variance)
        total = _share(counts @ (a - ab) ** 2 / 2.0, variance)
        result[2, varies, j] = half_width * first.std(axis=0, ddof=1)
        result[3, varies, j] = half_width * total.std(axis=0, ddof=1)
    return result[0], result[1], result[2], result[3]


def _share(part: FloatArray, variance: FloatArray) -> FloatArray:
    """Divide a part by the variance of its resample; 0 where the resample does not vary, as SALib does."""
    some = variance > np.finfo(np.float64).eps
    return np.divide(part, variance, out=np.zeros_like(part), where=some)


def _bootstrap_counts(rng: np.random.Generator, n: int, n_resamples: int) -> FloatArray:
    """Draw bootstrap samples as the share of each block in each of them, so that means are matrix products.

    Returns:
        Shares, rows summing to 1. Shape (r, n). [1]
    """
    drawn: IntArray = rng.integers(n, size=(n, n_resamples))
    counts = np.zeros((n_resamples, n))
    np.add.at(counts, (np.broadcast_to(np.arange(n_resamples), drawn.shape), drawn), 1.0)
    return counts / n


def _mean_over_time(indices: FloatArray) -> FloatArray:
    defined = np.isfinite(indices)
    n_defined = defined.sum(axis=0)
    total = np.where(defined, indices, 0.0).sum(axis=0)
    return np.where(n_defined > 0, total / np.maximum(n_defined, 1), np.nan)
