"""Sobol indices of every output at every time step."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from simulation.store.stored_model import StoredModel

# An output that varies by less than this fraction of its size does not vary: float32 networks repeat to 1e-6.
UNVARYING = 1e-6
# Of the bootstrapped intervals, as SALib has it.
CONFIDENCE_LEVEL = 0.95
OnProgress = Callable[[int, int], None]
"""Called with the rows done and their number in all."""


@dataclass(frozen=True, eq=False)
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
        n_train: Training-set size of the surrogate that was asked; None where it was the model itself.
    """

    # For whoever stores it: its fields are arrays.
    __pydantic_config__: ClassVar = {"arbitrary_types_allowed": True}

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
    n_train: int | None = None

    def order(self, output: int = 0) -> tuple[int, ...]:
        """Return the parameters' positions, most influential first by mean first order, as in Fig. 5."""
        mean = np.nan_to_num(mean_over_time(self.first_order)[output], nan=-np.inf)
        return tuple(int(i) for i in np.argsort(-mean, kind="stable"))

    @property
    def mean(self) -> dict[str, tuple[float | None, float | None]]:
        """First and total order of the first output, averaged over time; None where undefined. [1]."""
        orders = np.stack([mean_over_time(self.first_order)[0], mean_over_time(self.total_order)[0]]).tolist()
        first, total = ([None if np.isnan(one) else one for one in order] for order in orders)
        return {self.names[i]: (first[i], total[i]) for i in self.order()}

    @property
    def has_failures(self) -> bool:
        """Whether a failed row cost a block."""
        return self.n_dropped > 0


def sobol_indices(
    model: ForwardModel,
    *,
    n_base: int,
    seed: int,
    n_resamples: int = 100,
    on_progress: OnProgress = lambda n_done, total: None,
) -> SobolIndices:
    """Estimate first- and total-order Sobol indices at every step (App. B; doi 10.1016/j.cpc.2009.09.018).

    Parameters vary uniformly between their bounds, as the training set does (Eq. 2), whatever their scale.

    Args:
        model: Model to ask; usually the surrogate, since it is asked n_base (p + 2) times.
        n_base: Saltelli blocks, a power of two of at least 2: Sobol' sequences are balanced there alone.
        seed: Seed of the sample and of the bootstrap; 0 is a seed like any other.
        n_resamples: Bootstrap samples behind the confidence intervals, at least 2.
        on_progress: Called with the rows done and their number in all.

    Returns:
        The indices. A block with a failed row is left out as a whole, since its rows belong together.
    """
    space = model.parameter_space
    theta = saltelli_design(space, n_base, seed)
    y = _asked(model, theta, on_progress)
    blocks = y.reshape(n_base, space.n_parameters + 2, -1)
    # A failed block takes its own draws with it and shifts no others.
    good = np.isfinite(blocks).all(axis=(1, 2))
    weights = _weights(np.random.default_rng(seed), n_base, n_resamples)[:, good]
    variance, estimates = _estimates(blocks[good], weights)
    first, total, first_ci, total_ci = estimates.reshape(4, *y.shape[1:], -1)
    return SobolIndices(
        time=model.time,
        names=space.names,
        output_names=tuple(model.output_names),
        first_order=first,
        total_order=total,
        first_order_ci=first_ci,
        total_order_ci=total_ci,
        variance=variance.reshape(y.shape[1:]),
        n_base=n_base,
        n_dropped=n_base - int(good.sum()),
        n_calls=len(theta),
    )


def with_error_of_surrogate(found: SobolIndices, n_train: int, unexplained: float) -> SobolIndices:
    """Return the indices of a surrogate with intervals that also hold what it does not explain.

    Where the error is independent of the prediction, it adds a variance of `unexplained` times the output's.
    That part is spread over the p parameters alike: an index S so changes by about 2 sqrt(S u) + u with
    u = unexplained / p.

    Args:
        found: The surrogate's indices.
        n_train: Its training-set size.
        unexplained: Part of the variance that it leaves, by rows that it was not trained on. [1]
    """
    share = max(unexplained, 0.0) / len(found.names)

    def widened(index: FloatArray, half_width: FloatArray) -> FloatArray:
        more = 2.0 * np.sqrt(np.maximum(index, 0.0) * share) + share
        return np.asarray(np.hypot(half_width, more))

    return replace(
        found,
        n_train=n_train,
        first_order_ci=widened(found.first_order, found.first_order_ci),
        total_order_ci=widened(found.total_order, found.total_order_ci),
    )


def saltelli_design(space: ParameterSpace, n_base: int, seed: int) -> FloatArray:
    """Return the rows that the indices are estimated from. Shape (n_base (p + 2), p). [per parameter].

    Args:
        space: The p parameters.
        n_base: Saltelli blocks, a power of two.
        seed: Seed of the sample; 0 is a seed like any other.
    """
    # Not where stored indices are only read: the two take a second.
    from SALib.sample import sobol

    # Parameters with constraints are not independent, their coordinates in the unit cube are.
    ends = [[0.0, 1.0]] * space.n_parameters
    declared = {
        "num_vars": space.n_parameters,
        "names": list(space.names),
        "bounds": ends if space.is_bent else np.column_stack([space.lower, space.upper]).tolist(),
    }
    # Second order would take 2 p + 2 rows per block instead of p + 2.
    rows = sobol.sample(declared, n_base, calc_second_order=False, seed=seed)
    return space.from_unit(rows) if space.is_bent else rows


def _asked(model: ForwardModel, theta: FloatArray, on_progress: OnProgress) -> FloatArray:
    """Return the outputs of the rows. Shape (n, t, k). [output's unit]."""
    if not isinstance(model, StoredModel):
        y = model.simulate(theta).y
        on_progress(len(theta), len(theta))
        return y
    model.complete(theta, on_progress=lambda n_done: on_progress(n_done, len(theta)))
    answer = model.store.read(theta)
    model.failures += filter(None, answer.failures)
    return answer.y


def _estimates(blocks: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimate the indices of d columns.

    Args:
        blocks: Rows A, AB_1 ... AB_p, B of every block that has not failed. Shape (m, p + 2, d).
            [output's unit]
        weights: How often each block counts: once, then as the bootstrap has drawn it. Shape (r + 1, m). [1]

    Returns:
        The variance, shape (d,), [output's unit squared]; first and total order and their confidence half
        widths, NaN where a column does not vary, shape (4, d, p). [1]
    """
    from scipy.stats import norm

    m, p, d = len(blocks), blocks.shape[1] - 2, blocks.shape[2]
    result = np.full((4, d, p), np.nan)
    if not m:
        return np.full(d, np.nan), result
    varies = np.ptp(blocks, axis=(0, 1)) > UNVARYING * np.abs(blocks).max(axis=(0, 1))
    # The first-order estimator is biased for outputs that are not centered, so SALib standardizes: only the
    # mean makes a difference.
    z = blocks - blocks.mean(axis=(0, 1))
    a, b, n = z[:, 0], z[:, -1], np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    # Over A and B, 2 n rows: those of AB share values with both. Rounding alone must not make it negative.
    mean = weights @ (a + b) / (2.0 * n)
    variance = np.maximum(weights @ (a**2 + b**2) / (2.0 * n) - mean**2, 0.0)
    # Normal intervals of the bootstrap's deviation, as SALib reports them.
    half_width = norm.ppf(0.5 + CONFIDENCE_LEVEL / 2.0)
    for j in range(p if m >= 2 else 0):
        step = z[:, j + 1] - a
        # First order: Saltelli et al. 2010, Table 2 (b). Total order: Jansen, Table 2 (f).
        for i, part in enumerate((weights @ (b * step) / n, weights @ step**2 / (2.0 * n))):
            share = _share(part, variance)
            result[i, varies, j] = share[0, varies]
            result[2 + i, varies, j] = half_width * share[1:, varies].std(axis=0, ddof=1)
    return variance[0], result


def _share(part: FloatArray, variance: FloatArray) -> FloatArray:
    """Divide a part by the variance of its resample; 0 where the resample does not vary, as SALib does."""
    some = variance > np.finfo(np.float64).eps * variance[0]
    return np.divide(part, variance, out=np.zeros_like(part), where=some)


def _weights(rng: np.random.Generator, n: int, n_resamples: int) -> FloatArray:
    """Draw bootstrap samples as how often each block is in them, so that sums are matrix products.

    Returns:
        Ones, then one row per sample. Shape (r + 1, n). [1]
    """
    drawn: IntArray = rng.integers(n, size=(n, n_resamples))
    counts = np.zeros((1 + n_resamples, n))
    counts[0] = 1.0
    np.add.at(counts, (np.broadcast_to(1 + np.arange(n_resamples), drawn.shape), drawn), 1.0)
    return counts


def mean_over_time(indices: FloatArray) -> FloatArray:
    """Average indices over the time steps where they are defined; NaN where they never are.

    Args:
        indices: Shape (t, ...). [1]

    Returns:
        Shape (...). [1]
    """
    defined = np.isfinite(indices)
    n_defined = defined.sum(axis=0)
    total = np.where(defined, indices, 0.0).sum(axis=0)
    return np.where(n_defined > 0, total / np.maximum(n_defined, 1), np.nan)
