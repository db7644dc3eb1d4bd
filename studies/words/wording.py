"""How numbers, units and counts are written, the same in every figure, table and sentence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simulation.case import Case
    from simulation.measurement import MeasuredOutput

MISSING = "–"
AT_BOUND = 0.01
"""Closer to a bound than this share of the range is at the bound."""

NATIVE_CODE = "an FMU is native code that runs with your rights; SECURITY.md says how to run one apart"


def significant(value: float | None, digits: int = 3) -> str:
    """Write a number with so many significant digits, without an exponent where it stays readable."""
    if value is None or math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:,.{decimals}f}"


def setting(value: Any) -> str:
    """Write a setting such as a hyperparameter; of a fraction without the zeros that say nothing."""
    if not isinstance(value, float):
        return MISSING if value is None else str(value)
    text = significant(value)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def cell_text(value: object) -> str:
    """Write a value of a table whose kind is not known beforehand."""
    if isinstance(value, float):
        return significant(value)
    return MISSING if value is None else f"{value:,}" if type(value) is int else str(value)


def digits_between(low: float, high: float, least: int = 3) -> int:
    """Return with how many digits the ends of an interval differ, two of its width among them."""
    width, largest = abs(high - low), max(abs(low), abs(high))
    if not 0.0 < width < math.inf:
        return least
    return min(max(least, math.ceil(math.log10(largest / width)) + 1), 12)


def declared(value: float) -> str:
    """Write a number as it was declared, without rounding and without the noise of floating point."""
    return f"{value:,.10g}"


def count(value: float, noun: str = "", plural: str = "") -> str:
    """Write a count with its noun, e.g. "1 call", "4,096 calls"."""
    n = round(value)
    return f"{n:,} {noun if n == 1 else plural or f'{noun}s'}" if noun else f"{n:,}"


def in_letters(n: int) -> str:
    """Write a small number in letters, e.g. "four of these five"."""
    letters = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
    return letters[n] if n < len(letters) else f"{n:,}"


def ended(reason: str, *, converged: bool) -> str:
    """Say how a search ended, and whether it has converged."""
    return f"{'Converged' if converged else 'Stopped'}: {reason}"


def percent(fraction: float | None) -> str:
    """Write a fraction as a percentage; a nearly-all or nearly-none is not rounded to all or none."""
    if fraction is None or math.isnan(fraction):
        return MISSING
    size, sign = abs(fraction), "-" if fraction < 0 else ""
    if 0 < size < 0.001 or 0.999 < size < 1:
        beyond = "under" if (size < 0.5) == (fraction > 0) else "over"
        return f"{beyond} {sign}{'0.1' if size < 0.5 else '99.9'} %"
    text = f"{100 * size:.0f}"
    if text in ("0", "100") and size not in (0.0, 1.0):
        text = f"{100 * size:.1f}"
    return f"{sign}{text} %"


def percent_of_seeds(fraction: float | None, deviation: float | None) -> str:
    """Write a fraction as a percentage, with its standard deviation where that is known."""
    if deviation is None or fraction is None:
        return percent(fraction)
    return f"{percent(fraction).removesuffix(' %')} ± {100 * deviation:.0f} %"


def bound_at(u: float) -> str:
    """Return which bound a calibrated value lies at, "" for none.

    Args:
        u: The value in the calibration's coordinates, 0 at the lower bound and 1 at the upper. [1]
    """
    return "lower" if u < AT_BOUND else "upper" if u > 1.0 - AT_BOUND else ""


def shown_unit(unit: str) -> str:
    """Write a unit as readers know it: °C for degC, nothing for 1."""
    return {"degC": "°C", "1": ""}.get(unit, unit)


def difference_unit(unit: str) -> str:
    """Return the unit of a difference of two values in `unit`: K for every temperature."""
    return "K" if unit in ("degC", "°C", "K") else shown_unit(unit)


def squared(unit: str) -> str:
    """Write the square of a unit."""
    if not unit:
        return ""
    return f"({unit})²" if any(sign in unit for sign in " ./*²") else f"{unit}²"


def square_of(unit: str) -> str:
    """Return the unit of the mean squared error of an output in `unit`."""
    return squared(difference_unit(unit))


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a number with its unit."""
    return f"{significant(value, digits)} {unit}".strip()


def axis_label(what: str, unit: str) -> str:
    """Write the label of an axis or a column, e.g. "TAir [°C]"."""
    return f"{what} [{unit}]" if unit else what


def moment_of(case: Case, output: MeasuredOutput, sample: int) -> str:
    """Write when a sample was taken: as the recording does, else as the case file counts."""
    from simulation.time_unit import DAY_S, unit_for  # numpy, which words on the command line do without

    if output.samples.stamps:
        return output.samples.stamps[sample]
    since_s = float(output.samples.time[sample] - case.measurement.time[0])
    return unit_for(case.window_d[1] * DAY_S).moment(case.window_d[0] + since_s / DAY_S)


def compared_in(case: Case) -> str:
    """Say which part was measured: "on days 0 to 10", "in experiments a and b"."""
    names = [one.experiment for one in case.experiments]
    if not names:
        from simulation.time_unit import period_text  # numpy, which words on the command line do without

        return f"on {period_text(case.window_d)}"
    return f"in {'experiment' if len(names) == 1 else 'experiments'} {listed(names)}"


def listed(items: Iterable[str]) -> str:
    """Join items to a phrase: a, b and c."""
    words = list(items)
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else ""
