"""Units in which long times are written and read: a case of seconds is not written in days."""

from dataclasses import dataclass

from simulation.arrays import FloatArray

DAY_S = 86400.0


@dataclass(frozen=True)
class TimeUnit:
    """A unit of time.

    Attributes:
        symbol: As it stands behind a number.
        seconds: Its length. [s]
    """

    symbol: str
    seconds: float

    def of_days(self, days: float) -> float:
        """Convert days. [this unit]."""
        return days * (DAY_S / self.seconds)

    def to_days(self, value: float) -> float:
        """Convert a time in this unit. [d]."""
        return float(value) if self is DAYS else value * self.seconds / DAY_S

    def of_seconds(self, time: FloatArray) -> FloatArray:
        """Convert times. Shape (t,). [this unit]."""
        return time / self.seconds

    def moment(self, days: float) -> str:
        """Write a moment: day 8, or 10 s."""
        value = f"{self.of_days(days):.6g}"
        return f"day {value}" if self is DAYS else f"{value} {self.symbol}"

    def period(self, days: tuple[float, float]) -> str:
        """Write a period: days 0 to 10, or 0 to 10 s."""
        begin, end = (f"{self.of_days(one):.6g}" for one in days)
        return f"days {begin} to {end}" if self is DAYS else f"{begin} to {end} {self.symbol}"


SECONDS, MINUTES = TimeUnit("s", 1.0), TimeUnit("min", 60.0)
HOURS, DAYS = TimeUnit("h", 3600.0), TimeUnit("d", DAY_S)
UNITS = {unit.symbol: unit for unit in (SECONDS, MINUTES, HOURS, DAYS)}


def unit_for(span_s: float) -> TimeUnit:
    """Choose the unit in which a span reads well: half a day is written in days, two hours in hours."""
    if span_s >= 0.45 * DAY_S:
        return DAYS
    return next((unit for unit in (HOURS, MINUTES) if span_s >= 2.0 * unit.seconds), SECONDS)


def period_text(days: tuple[float, float]) -> str:
    """Write a period in the unit that suits its end: days 8 to 8.5, or 0 to 10 s."""
    return unit_for(days[1] * DAY_S).period(days)
