"""Table 4 and Fig. 9 in words: titles, captions and the verdict, each with its numbers."""

from collections.abc import Mapping, Sequence

import numpy as np

from simulation.arrays import FloatArray
from studies.paper.published import USUAL_MSE, published_calibration
from studies.paper.result import Agreement
from studies.report.figures_polish_paths import PolishPath
from studies.report.findings import quartiles
from studies.report.wording import count, listed, quantity, significant

Values = dict[str, FloatArray]
"""Every quantity of a size by its name, one value per seed. Each of shape (s,)."""

POLISHES = ("squared_mse", "mse_polished")
"""Final errors of the polish as the paper writes it, and of ours."""


def middle(values: FloatArray) -> float:
    """Return the median; infinite where the target was not reached by half of the seeds."""
    return float(quartiles(values)[1])


def theirs_of(n_train: int) -> dict[str, float]:
    """Return the paper's row of a size by our names."""
    row = published_calibration(n_train)
    if row is None:
        return {}
    return {
        "mse_screened": row.mse_screened,
        "n_polish": row.n_polish,
        "mse_polished": row.mse_polished,
        "total_paper": row.total,
    }


def _n_seeds(many: Mapping[int, Values]) -> int:
    return max(len(values["test_mae"]) for values in many.values())


def seeds_title(many: Mapping[int, Values]) -> str:
    """Say how many calls each size with several seeds takes."""
    said = [_reached(middle(values["calls_to_usual"])) for values in many.values()]
    return f"Median model calls to {USUAL_MSE}: {listed(said)} for n = {listed(map(count, many))}"


def _reached(calls: float) -> str:
    return count(calls) if np.isfinite(calls) else "never"


def title(paths: Sequence[PolishPath], unit: str) -> str:
    """Say what Fig. 9 shows."""
    gaps = [one.mse_screened - one.mse_surrogate for one in paths]
    finals = [float(one.mse[-1]) for one in paths]
    return (
        f"The gap at the screened point is {significant(min(gaps))} to {quantity(max(gaps), unit)}; "
        f"polishing ends at {significant(min(finals))} to {quantity(max(finals), unit)}"
    )


def caption(paths: Sequence[PolishPath], unit: str) -> str:
    """Explain Fig. 9."""
    first, last = (
        f"{quantity(one.mse_screened - one.mse_surrogate, unit)} at n = {count(one.n_train)}"
        for one in (paths[0], paths[-1])
    )
    return (
        "Left: MSE at the screened point by the surrogate and by the FMU; the gap goes from "
        f"{first} to {last}. Right: the best MSE over the calls of the polish. One seed."
    )


def verdict_of(
    medians: Mapping[int, Mapping[str, float]], values: Mapping[int, Values], unit: str
) -> tuple[Agreement, str]:
    """Say how Table 4 compares with the paper: it agrees where no final MSE is above the paper's.

    Args:
        medians: of each size, by name of the quantity.
        values: the same of each seed.
        unit: unit of an MSE.
    """
    compared = [(n, row, paper) for n, row in medians.items() if (paper := theirs_of(n))]
    if not compared:
        return "beyond the paper", "None of these sizes is in the paper's table."
    no_worse = [n for n, row, paper in compared if row["mse_polished"] <= paper["mse_polished"]]
    smaller_gap = [n for n, row, paper in compared if row["mse_screened"] <= paper["mse_screened"]]
    cheaper = [n for n, row, paper in compared if row["calls_to_paper"] <= paper["total_paper"]]
    m = len(compared)
    agreement: Agreement = "agrees" if len(no_worse) == m else "agrees in part" if no_worse else "differs"
    parts = [
        f"The final MSE is no worse than the paper's at {len(no_worse)} of {m} sizes, the FMU's MSE at the "
        f"screened point at {len(smaller_gap)} of {m}. The paper's final MSE is reached within the paper's "
        f"calls at {len(cheaper)} of {m}" + (f" (n = {listed(map(count, cheaper))})." if cheaper else "."),
    ]
    first, last = medians[min(medians)], medians[max(medians)]
    if len(medians) > 1:
        verb = "falls, as in the paper" if last["gap"] < first["gap"] else "does not fall"
        parts.append(f"From the smallest to the largest training set the gap {verb}.")
    cheapest = min(medians, key=lambda n: (medians[n]["calls_to_usual"], n))
    if np.isfinite(medians[cheapest]["calls_to_usual"]):
        calls = count(medians[cheapest]["calls_to_usual"])
        parts.append(f"Fewest calls to {USUAL_MSE}: {calls}, with n = {count(cheapest)}.")
    theirs, ours = (middle(np.array([row[key] for row in medians.values()])) for key in POLISHES)
    parts.append(
        "Polished with squared residuals in linear coordinates, from the same points, the final MSE is "
        f"{quantity(theirs, unit)} in the median of the sizes against {quantity(ours, unit)}"
        + (": the form of the polish makes a difference." if theirs > 1.05 * ours else ".")
    )
    many = {n: found for n, found in values.items() if len(found["test_mae"]) > 1}
    if many:
        said = []
        for n, found in many.items():
            low, median, high = quartiles(found["calls_to_usual"]).tolist()
            spread = f"quartiles {_reached(low)} and {_reached(high)}"
            said.append(f"{_reached(median)} calls ({spread}) at n = {n}")
        parts.append(
            f"Over {count(_n_seeds(many), 'seed')}, {USUAL_MSE} {unit} is reached after {listed(said)}, in "
            "the median. The paper has one run per size; the quartiles show what another seed changes."
        )
    return agreement, " ".join(parts)
