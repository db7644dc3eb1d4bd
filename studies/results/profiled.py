"""What profile likelihoods come to."""

from dataclasses import dataclass

from simulation.arrays import FloatArray
from studies.results.saved import WITH_ARRAYS, Error


@dataclass(frozen=True)
class Profiled:
    """The profile of one parameter.

    Attributes:
        interval: Ends of its interval; a bound where the profile stays within. [parameter's unit]
        at_bound: Whether the profile stays within up to the lower and to the upper bound.
        rise: What -2 log L rises by at both ends by a simulation; infinite where it failed. [1]
        moves: Parameters that move at least half as far along the profile as this one: its ridge.
    """

    interval: tuple[float, float]
    at_bound: tuple[bool, bool]
    rise: tuple[Error, Error]
    moves: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Profiles:
    """Profile likelihoods of the parameters of a calibration.

    Attributes:
        calibration: Name of the calibration.
        level: Probability with which an interval holds the true value, of many measurements. [1]
        limit: What -2 log L rises by at the ends of an interval. [1]
        parameters: The profile of each.
        n_calls: Simulations at the ends.
        by_equations: Whether state equations gave the profiles; else a Gaussian process.
        is_confirmed: Whether simulations at the ends show the rise that is expected there.
        at: Values of the parameters along the profiles between their bounds, NaN beyond. Shape (p, g). [1]
        rises: What -2 log L rises by there. Shape (p, g). [1]
    """

    __pydantic_config__ = WITH_ARRAYS

    calibration: str
    level: float
    limit: float
    parameters: dict[str, Profiled]
    n_calls: int
    by_equations: bool
    is_confirmed: bool
    at: FloatArray
    rises: FloatArray

    @property
    def has_failures(self) -> bool:
        """Whether a simulation at an end failed."""
        return any(max(one.rise) == float("inf") for one in self.parameters.values())
