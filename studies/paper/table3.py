"""Tables 2 and 3: optimizers coupled directly with the FMU, beside the paper's calls and errors."""

from collections.abc import Sequence
from dataclasses import replace

from studies.paper.direct import Row, Start, computed
from studies.paper.items import Shown
from studies.paper.plan import Plan
from studies.paper.published import TABLE_3
from studies.report.wording import difference_unit, squared

TOLERANCE_TRF = 1e-4
"""Inferred: with SciPy's 1e-8, LS-TRF takes 700 to 2000 calls per start, with this about the paper's 200."""

SETTINGS = {
    "Powell": Row("Powell", max_calls=5000),
    "Nelder-Mead": Row("Nelder-Mead", max_calls=5000),
    "SLSQP": Row("SLSQP"),
    "LS-TRF": Row("LS-TRF", tolerance=TOLERANCE_TRF),
    "Differential evolution": Row("Differential evolution", max_calls=748_020, tolerance=1e-4),
}
"""Limits that Table 3 shows: 5000 calls exactly from the guess, 3,562 generations of 15 x 14 points; the
tolerance of evolution is inferred, as with SciPy's 0.01 it ends after some 140,000 calls.

The paper's numbers show (calls per start, best 5 % and mean over starts) that its optimizers saw
the parameters as they are, and LS-TRF signed residuals.
"""

Found = list[tuple[Row, tuple[Start, ...], int | None, float | None]]


def run(plan: Plan) -> Shown:
    """Compute the rows of the budget, in the order of the paper, and LS-TRF in two other forms."""
    study, folder = plan.study, plan.folder("table3")
    seed = study.profile.seed
    rows: list[tuple[Row, int | None, float | None]] = [
        (replace(SETTINGS[method], n_starts=n_starts, seed=seed), n_calls, mse)
        for method, n_starts, n_calls, mse in TABLE_3
        if n_calls <= plan.budget.max_row_calls
    ]
    own = replace(SETTINGS["LS-TRF"], seed=seed)
    rows += [(replace(own, is_squared=True), None, None), (replace(own, in_unit_cube=True), None, None)]
    found: Found = [(row, computed(study, row, folder), n_calls, mse) for row, n_calls, mse in rows]
    unit = squared(difference_unit(study.case.outputs[0].unit))
    return Shown(
        f"Table 3: optimizers on the FMU; of many starts the best; MSE [{unit}]",
        ("method", "calls", "MSE", "paper: calls", "paper: MSE"),
        tuple((row.title, *_sum(starts), n_calls, mse) for row, starts, n_calls, mse in found),
    )


def _sum(starts: Sequence[Start]) -> tuple[int, float]:
    return sum(one.n_calls for one in starts), min(one.mse for one in starts)
