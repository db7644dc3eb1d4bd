"""What planning the next experiment comes to."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Candidate:
    """An experiment that might be made, and what it would show.

    Attributes:
        name: Its name.
        what: What it is, in words.
        days: How long it takes. [d]
        half_widths: Half of the 90 % interval expected of each parameter, as a share of its range. [1]
        shrinks_to: Mean of these over what they are now. [1]
        merit: What the criterion says; the less, the better. [1]
        determines: Parameters that it would determine and the present data do not.
        own: Parameters of which it would have a value of its own.
        n_calls: Simulations that this took.
        by_equations: Whether state equations gave it.
        excluded: Why it is not to be made; "" where it may be.
    """

    name: str
    what: str
    days: float
    half_widths: dict[str, float]
    shrinks_to: float
    merit: float
    determines: tuple[str, ...]
    own: tuple[str, ...]
    n_calls: int
    by_equations: bool
    excluded: str = ""


@dataclass(frozen=True)
class Planned:
    """Candidates for the next experiment, the best first.

    Attributes:
        calibration: Name of the calibration that it is planned around.
        criterion: What ranks them.
        n_points: Parameter sets over which half widths are averaged.
        half_widths: Half of the 90 % intervals now, linearised, as shares of the ranges. [1]
        candidates: The candidates.
        block: Place of the [[experiments]] tables of the best one; "" where none may be made.
        inputs: Place of a CSV file that it needs; "" for none.
        n_calls: All simulations.
        error: How far equations and a simulation of the best one differ at most, over its sensor's
            uncertainty; None where equations did not give it. [1]
    """

    calibration: str
    criterion: str
    n_points: int
    half_widths: dict[str, float]
    candidates: tuple[Candidate, ...]
    block: str
    inputs: str
    n_calls: int
    error: float | None

    @property
    def has_failures(self) -> bool:
        """Whether a candidate could not be simulated."""
        return any(one.excluded.startswith("a simulation failed") for one in self.candidates)
