"""The rows of the paper's Tables 2 and 3: which optimizer, from how many starts, drawn how; nothing heavy."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.parameters import ParameterSpace

Method = Literal["powell", "nelder-mead", "slsqp", "ls-trf", "differential-evolution"]
Objective = Literal["residuals", "squared", "scalar"]
Coordinates = Literal["physical", "log"]

TITLES: dict[Method, str] = {
    "powell": "Powell",
    "nelder-mead": "Nelder-Mead",
    "slsqp": "SLSQP",
    "ls-trf": "LS-TRF",
    "differential-evolution": "Differential evolution",
}

MAX_CALLS_LOCAL = 5000
"""The limit that Table 3 shows: Nelder-Mead and Powell end at exactly 5000 calls from the initial guess."""

TOLERANCE_TRF = 1e-4
"""Inferred: with SciPy's 1e-8, LS-TRF takes 700 to 2000 calls per start, with this about the paper's 200."""

TOLERANCE_EVOLUTION = 1e-4
"""Inferred: with SciPy's 0.01 it ends after some 140,000 calls, with this it goes on to the paper's count."""

MAX_CALLS_EVOLUTION = 748_020
"""The paper's count: 3,562 generations of 15 x 14 points, so without SciPy's closing L-BFGS-B."""


@dataclass(frozen=True)
class PublishedRow:
    """What the paper printed.

    Attributes:
        n_calls: Model calls.
        mse: MSE at the end. [K²]
    """

    n_calls: int
    mse: float


@dataclass(frozen=True)
class DirectRow:
    """An optimizer coupled directly with the physical model.

    Attributes:
        method: SciPy's optimizer.
        start: "guess" for the case's estimates alone, else the number of starts: the first is the guess, the
            others are drawn (Table 2, "Multistart").
        objective: "scalar" is the MSE; "residuals" hands signed residuals to least squares, "squared" their
            squares as Table 2 says, which minimizes fourth powers. The error reported is the MSE always.
        coordinates: What the optimizer sees: "physical" the parameters as they are, "log" the unit cube in
            the scales of the case.
        seed: Of the drawn starts, or of differential evolution.
        max_calls: Most model calls of one start; None for no limit but the optimizer's own.
        tolerance: `tol` of `minimize` and of `differential_evolution`, `ftol` and `xtol` of `least_squares`;
            None for SciPy's default.
    """

    method: Method
    start: Literal["guess"] | int = "guess"
    objective: Objective = "scalar"
    coordinates: Coordinates = "physical"
    seed: int = 0
    max_calls: int | None = None
    tolerance: float | None = None

    def __post_init__(self) -> None:
        for key, value, known in (
            ("method", self.method, get_args(Method)),
            ("objective", self.objective, get_args(Objective)),
            ("coordinates", self.coordinates, get_args(Coordinates)),
        ):
            if value not in known:
                raise InputError(f"{key} = {value!r} is unknown; give one of {', '.join(known)}")
        if self.start != "guess" and self.start < 1:
            raise InputError(f"start is {self.start}; give 'guess' or at least 1")
        if (self.method == "ls-trf") == (self.objective == "scalar"):
            raise InputError(
                f"{self.method} cannot minimize {self.objective!r}; LS-TRF takes residuals or squared, "
                "the others scalar"
            )
        if self.method == "differential-evolution" and self.n_starts > 1:
            raise InputError("differential evolution has no starting points; leave start at 'guess'")
        if self.tolerance is not None and not self.tolerance > 0.0:
            raise InputError(f"tolerance is {self.tolerance}; give a positive number")
        if self.max_calls is not None and self.max_calls < 1:
            raise InputError(f"max_calls is {self.max_calls}; give at least 1")

    @property
    def n_starts(self) -> int:
        """Number of starts, the guess included."""
        return 1 if self.start == "guess" else self.start

    @property
    def series(self) -> str:
        """Name of the starts: rows that differ in their number alone share them, as more extend fewer."""
        chosen = [self.method, self.objective, self.coordinates, f"seed{self.seed}"]
        if self.tolerance is not None:
            chosen.append(f"tol{self.tolerance:g}")
        if self.max_calls is not None:
            chosen.append(f"max{self.max_calls}")
        return "-".join(chosen)

    @property
    def name(self) -> str:
        """Name of the row's files and its word on the command line."""
        return f"{self.series}-{self.n_starts:03d}"

    @property
    def title(self) -> str:
        """The row as Table 3 calls it."""
        if self.method == "differential-evolution":
            return TITLES[self.method]
        starts = "initial guess" if self.n_starts == 1 else f"{self.n_starts} starts"
        return f"{TITLES[self.method]} with {starts}"


@dataclass(frozen=True)
class PaperRow:
    """A row of Table 3, and what the paper printed there.

    Attributes:
        row: How it is computed here.
        published: The paper's numbers; None for a row that it has not.
    """

    row: DirectRow
    published: PublishedRow | None


def paper_rows(seed: int = 0) -> tuple[PaperRow, ...]:
    """List the fifteen rows of Table 3 in the paper's order.

    As the paper's numbers tell (calls per start, best 5 % and mean over starts), its optimizers saw the
    parameters as they are, and LS-TRF signed residuals.

    Args:
        seed: Seed of the starts and of differential evolution.
    """
    trf = DirectRow("ls-trf", objective="residuals", seed=seed, tolerance=TOLERANCE_TRF)
    slsqp = DirectRow("slsqp", seed=seed)
    simplex = DirectRow("nelder-mead", seed=seed, max_calls=MAX_CALLS_LOCAL)
    powell = DirectRow("powell", seed=seed, max_calls=MAX_CALLS_LOCAL)
    evolution = DirectRow(
        "differential-evolution", seed=seed, max_calls=MAX_CALLS_EVOLUTION, tolerance=TOLERANCE_EVOLUTION
    )
    table: tuple[tuple[DirectRow, Literal["guess"] | int, int, float], ...] = (
        (trf, "guess", 261, 0.0117),
        (slsqp, "guess", 650, 0.0149),
        (trf, 16, 3486, 0.0114),
        (simplex, "guess", 5000, 0.0126),
        (powell, "guess", 5000, 0.0881),
        (trf, 32, 6311, 0.0114),
        (trf, 64, 12612, 0.0113),
        (slsqp, 16, 18245, 0.0117),
        (simplex, 16, 76483, 0.0117),
        (powell, 16, 79120, 0.0134),
        (slsqp, 64, 86322, 0.0114),
        (simplex, 64, 286728, 0.0110),
        (powell, 64, 319322, 0.0125),
        (evolution, "guess", 748020, 0.0104),
        (simplex, 256, 1188496, 0.0111),
    )
    return tuple(
        PaperRow(replace(row, start=start), PublishedRow(n_calls, mse)) for row, start, n_calls, mse in table
    )


def published_row(row: DirectRow) -> PublishedRow | None:
    """Return the paper's numbers for a row of its method and number of starts; None where it has none."""
    for one in paper_rows():
        if (one.row.method, one.row.n_starts) == (row.method, row.n_starts):
            return one.published
    return None


def start_points(space: ParameterSpace, row: DirectRow) -> FloatArray:
    """Draw the starting points as the paper's Table 2 does: the guess, then normal draws around it.

    The paper's "variance 0.5 (theta+ - theta-)" has the unit of a standard deviation and is read as one.
    "Repeated until a combination within the bounds is found" keeps the
    parameters independent: each is a normal variable truncated at its bounds, drawn here by its inverse.
    Start j depends on the seed and j alone.

    Args:
        space: The parameters; one without an estimate starts in the middle of its box.
        row: Number of starts and seed.

    Returns:
        Starting points. Shape (s, p). [per parameter]
    """
    from scipy.special import ndtr, ndtri

    guess = space.expected
    sigma = 0.5 * (space.upper - space.lower)
    low, high = ndtr((space.lower - guess) / sigma), ndtr((space.upper - guess) / sigma)
    starts = np.empty((row.n_starts, space.n_parameters))
    starts[0] = guess
    for j in range(1, row.n_starts):
        u = np.random.default_rng([row.seed, j]).random(space.n_parameters)
        starts[j] = guess + sigma * ndtri(low + u * (high - low))
    return np.clip(starts, space.lower, space.upper)
