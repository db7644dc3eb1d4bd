"""Sobol indices of every output at every time step."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from simulation.store.stored_model import StoredModel
from studies.stages.saved import WITH_ARRAYS

# An output that varies by less than this fraction of its size does not vary: float32 networks repeat to 1e-6.
CONSTANT = 1e-6
# Rows per question: memory does not grow with the size of the design.
CHUNK = 2048
CONFIDENCE_LEVEL = 0.95

OnProgress = Callable[[int, int], None]


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
    """

    __pydantic_config__ = WITH_ARRAYS

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
        return mean_over_time(self.first_order)

    def mean_total_order(self) -> FloatArray:
        """Average the total-order indices over the steps where they are defined. Shape (k, p). [1]."""
        return mean_over_time(self.total_order)

    def order(self, output: int = 0) -> tuple[int, ...]:
        """Return the parameters' positions, most influential first by mean first order, as in Fig. 5."""
        mean = np.nan_to_num(self.mean_first_order()[output], nan=-np.inf)
        return tuple(int(i) for i in np.argsort(-mean, kind="stable"))

    @property
    def mean(self) -> dict[str, tuple[float | None, float | None]]:
        """First and total order of the first output, averaged over time; None where undefined. [1]."""
        orders = np.stack([self.mean_first_order()[0], self.mean_total_order()[0]]).tolist()
        first, total = ([None if np.isnan(one) else one for one in order] for order in orders)
        return {self.names[i]: (first[i], total[i]) for i in self.order()}

    @property
    def news(self) -> str:
        """How many rows they took."""
        return f"{self.n_calls} simulations reused"

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
    # Sobol' sequences are balanced at powers of two alone.
    if n_base < 2 or n_base & (n_base - 1):
        raise InputError(f"n_base is {n_base}; give a power of two, for example 512")
    if n_resamples < 2:
        raise InputError(f"n_resamples is {n_resamples}; give at least 2")
    space = model.parameter_space
    p = space.n_parameters
    theta = saltelli_design(space, n_base, seed)
    shape = (len(model.time), len(model.output_names))
    sums = _Sums(_weights(np.random.default_rng(seed), n_base, n_resamples), shape[0] * shape[1], p)
    for blocks in _saltelli_blocks(model, theta, on_progress):
        sums.add(blocks)
    first, total, first_ci, total_ci = (estimate.reshape(*shape, p) for estimate in sums.estimates())
    return SobolIndices(
        time=np.asarray(model.time, dtype=np.float64),
        names=space.names,
        output_names=tuple(model.output_names),
        first_order=first,
        total_order=total,
        first_order_ci=first_ci,
        total_order_ci=total_ci,
        variance=sums.variance()[0].reshape(shape),
        n_base=n_base,
        n_dropped=n_base - sums.n_good,
        n_calls=len(theta),
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

    declared = {
        "num_vars": space.n_parameters,
        "names": list(space.names),
        "bounds": np.column_stack([space.lower, space.upper]).tolist(),
    }
    # Second order would take 2 p + 2 rows per block instead of p + 2.
    return np.asarray(sobol.sample(declared, n_base, calc_second_order=False, seed=seed))


def _saltelli_blocks(
    model: ForwardModel, theta: FloatArray, on_progress: OnProgress | None
) -> Iterator[FloatArray]:
    """Ask the model and yield whole Saltelli blocks. Shape (m, p + 2, t*k). [output's unit]."""

    def advance(n_done: int) -> None:
        if on_progress is not None:
            on_progress(n_done, len(theta))

    size = theta.shape[1] + 2
    rest = np.empty((0, len(model.time) * len(model.output_names)))
    ask = model.simulate
    if isinstance(model, StoredModel):
        # No process waits for the next block.
        model.complete(theta, on_progress=advance)
        ask = model.store.read
    for start in range(0, len(theta), CHUNK):
        answer = ask(theta[start : start + CHUNK])
        if isinstance(model, StoredModel):
            model.failures += filter(None, answer.failures)
        else:
            advance(start + answer.n)
        rows = np.concatenate([rest, answer.y.reshape(answer.n, -1)])
        # A chunk may end within a block, whose rows belong together.
        whole = len(rows) // size * size
        rest = rows[whole:].copy()
        yield rows[:whole].reshape(-1, size, rows.shape[1])


class _Sums:
    """All that the indices of d columns follow from, over the Saltelli blocks so far.

    Every sum is there once per row of weights: the first counts each block once, the others are bootstrap
    samples. No output is kept, so that memory does not grow with the number of blocks.
    """

    def __init__(self, weights: FloatArray, d: int, p: int) -> None:
        self._weights, self._p = weights, p
        self._n_seen = self.n_good = 0
        self._n = np.zeros((len(weights), 1))
        self._low, self._high = np.full(d, np.inf), np.full(d, -np.inf)
        # Of a first guess at the mean, so that nothing large is subtracted from something large.
        self._shift: FloatArray | None = None
        self._all = np.zeros(d)
        self._ends, self._squares = np.zeros((2, len(weights), d))
        self._steps, self._steps_by_b, self._squared_steps = np.zeros((3, p, len(weights), d))

    def add(self, blocks: FloatArray) -> None:
        """Add blocks, except those with a failed row.

        Args:
            blocks: Rows A, AB_1 ... AB_p, B of every block. Shape (m, p + 2, d). [output's unit]
        """
        good = np.isfinite(blocks).all(axis=(1, 2))
        # By the place of a block, so a failed one takes its own draws with it and shifts no others.
        weights = self._weights[:, self._n_seen : self._n_seen + len(blocks)][:, good]
        self._n_seen += len(blocks)
        if not good.any():
            return
        self.n_good += int(good.sum())
        self._n += weights.sum(axis=1, keepdims=True)
        blocks = blocks[good]
        self._low = np.minimum(self._low, blocks.min(axis=(0, 1)))
        self._high = np.maximum(self._high, blocks.max(axis=(0, 1)))
        if self._shift is None:
            self._shift = blocks.mean(axis=(0, 1))
        z = blocks - self._shift
        self._all += z.sum(axis=(0, 1))
        a, b = z[:, 0], z[:, -1]
        self._ends += weights @ (a + b)
        self._squares += weights @ (a**2 + b**2)
        for j in range(self._p):
            step = z[:, j + 1] - a
            self._steps[j] += weights @ step
            self._steps_by_b[j] += weights @ (b * step)
            self._squared_steps[j] += weights @ step**2

    def variance(self) -> FloatArray:
        """Return the variance per row of weights. Shape (r + 1, d). [output's unit squared]."""
        if not self.n_good:
            return np.full_like(self._ends, np.nan)
        # Over A and B, 2 n rows: those of AB share values with both.
        n = 2.0 * np.maximum(self._n, 1.0)
        # Rounding alone must not make it negative.
        variance: FloatArray = np.maximum(self._squares / n - (self._ends / n) ** 2, 0.0)
        return variance

    def estimates(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return first and total order and their confidence half widths.

        Returns:
            Four arrays of shape (d, p); NaN where a column does not vary. [1]
        """
        from scipy.stats import norm

        result = np.full((4, len(self._all), self._p), np.nan)
        size = np.maximum(np.abs(self._low), np.abs(self._high))
        if self.n_good >= 2:
            varies = self._high - self._low > CONSTANT * size
            n, variance = np.maximum(self._n, 1.0), self.variance()
            # The first-order estimator is biased for outputs that are not centered, so SALib standardizes:
            # only the mean makes a difference.
            mean = self._all / (self.n_good * (self._p + 2))
            # Normal intervals of the bootstrap's deviation, as SALib reports them.
            half_width = norm.ppf(0.5 + CONFIDENCE_LEVEL / 2.0)
            for j in range(self._p):
                # First order: Saltelli et al. 2010, Table 2 (b). Total order: Jansen, Table 2 (f).
                first = _share((self._steps_by_b[j] - mean * self._steps[j]) / n, variance)
                total = _share(self._squared_steps[j] / (2.0 * n), variance)
                for i, share in enumerate((first, total)):
                    result[i, varies, j] = share[0, varies]
                    result[2 + i, varies, j] = half_width * share[1:, varies].std(axis=0, ddof=1)
        return result[0], result[1], result[2], result[3]


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
