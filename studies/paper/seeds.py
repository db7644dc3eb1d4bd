"""Table 4 over seeds: designs, trainings and screenings of their own, as medians and quartiles."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.paper.plan import Plan
from studies.paper.published import TABLE_4, USUAL_MSE, published_calibration
from studies.paper.result import ERROR, SQUARED_ERROR, Agreement, ItemResult
from studies.paper.table4 import row_of
from studies.paper.tuned import tune_sizes
from studies.report.contents import Picture
from studies.report.figures_polish_paths import SeedPanel, seeds_figure
from studies.report.findings import quartiles
from studies.report.tables import Column, Table
from studies.report.wording import count, difference_unit, listed, quantity, squared
from studies.stages.calibrate import calibrate_stage

QUANTITIES = (
    ("test_mae", "surrogate's test MAE", ERROR),
    ("mse_surrogate", "MSE by the surrogate", SQUARED_ERROR),
    ("mse_screened", "MSE by the FMU", SQUARED_ERROR),
    ("n_polish", "polish calls", ""),
    ("mse_polished", "final MSE", SQUARED_ERROR),
    ("total_paper", "calls (paper's count)", ""),
    ("calls_to_usual", f"calls to {USUAL_MSE}", ""),
)


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    budget, profile = plan.budget, plan.study.profile.to_dict()
    return {
        "seeds": list(plan.seeds),
        "n_train": list(budget.seed_sizes),
        "trials": budget.seed_trials,
        **{name: profile[name] for name in ("screening", "polish")},
        "tuning": {key: value for key, value in profile["tuning"].items() if key != "n_trials"},
        "sets": [profile["data"]["n_validation"], profile["data"]["n_test"]],
    }


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    sizes = plan.budget.seed_sizes
    each = plan.training_s(sizes, {max(sizes): plan.budget.seed_trials}) + len(sizes) * plan.screening_s()
    return len(plan.seeds) * each


def run(plan: Plan) -> ItemResult:
    """Do the whole method with every seed."""
    sizes = plan.budget.seed_sizes
    rows: dict[int, list[dict[str, Any]]] = {n: [] for n in sizes}
    n_calls = {"training sets": 0, "validation and test sets": 0, "screening checks": 0, "polish": 0}
    work_s, uses = 0.0, []
    for seed in plan.seeds:
        tuned = tune_sizes(plan.seed_study(seed), {max(sizes): plan.budget.seed_trials})
        work_s += tuned.wall_s
        n_calls["training sets"] += tuned.n_simulations["train set"]
        # Every seed is judged by the same validation and test sets.
        n_judged = tuned.n_simulations["validation set"] + tuned.n_simulations["test set"]
        n_calls["validation and test sets"] = n_judged
        for n in sizes:
            outcome = calibrate_stage(tuned.study, n)
            work_s += outcome.wall_s
            ledger = outcome.summary["ledger"]
            n_calls["screening checks"] += ledger["n_screen_checks"]
            n_calls["polish"] += ledger["n_polish"]
            rows[n].append({"seed": seed, **row_of(tuned.study, n, outcome.summary)})
        uses.append(f"studies calibrate {tuned.study.command} --method paper")
    error_unit = difference_unit(plan.study.case.outputs[0].unit)
    unit = squared(error_unit)
    agreement, verdict = _verdict(rows, unit)
    return ItemResult(
        agreement=agreement,
        verdict=verdict,
        numbers={
            "by_size": {n: {"rows": found, "quartiles": quartiles_of(found)} for n, found in rows.items()},
            "target": USUAL_MSE,
        },
        paper={"rows": [{"n_train": r.n_train, "mse": r.mse_polished, "total": r.total} for r in TABLE_4]},
        tables=(_table(rows, error_unit),),
        pictures=(
            Picture(
                "seeds",
                "How the result depends on the seed",
                "Dots: one seed each; bar: median and quartiles; ◆: the paper's one value.",
                lambda path: seeds_figure(
                    _panels(rows, unit), path, title=_title(rows), footnote=plan.study.label
                ),
            ),
        ),
        n_calls=n_calls,
        work_s=work_s,
        seeds={"designs, trials and screening": list(plan.seeds)},
        settings=(("trials per seed and size", str(plan.budget.seed_trials)),),
        metrics={
            f"median_calls/n{n:04d}": float(quartiles(_values(found, "calls_to_usual"))[1])
            for n, found in rows.items()
        },
        uses=tuple(uses),
    )


def quartiles_of(rows: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """Return quartiles and median of every quantity; a target that was never reached is infinite."""
    return {key: quartiles(_values(rows, key)).tolist() for key, _, _ in QUANTITIES}


def _values(rows: Sequence[dict[str, Any]], key: str) -> FloatArray:
    return np.array([np.inf if row[key] is None else row[key] for row in rows], dtype=np.float64)


def _table(rows: dict[int, list[dict[str, Any]]], error_unit: str) -> Table:
    columns = [Column("n_train", "training simulations"), Column("quantity", "quantity")]
    columns += [Column("lowest", "lowest"), Column("q25", "lower quartile"), Column("median", "median")]
    columns += [Column("q75", "upper quartile"), Column("highest", "highest"), Column("paper", "paper")]
    units = {ERROR: error_unit, SQUARED_ERROR: squared(error_unit)}
    cells: list[tuple[Any, ...]] = []
    for n, found in rows.items():
        paper = published_calibration(n)
        theirs = (
            {}
            if paper is None
            else {
                "mse_screened": paper.mse_screened,
                "n_polish": paper.n_polish,
                "mse_polished": paper.mse_polished,
                "total_paper": paper.total,
            }
        )
        for key, title, unit in QUANTITIES:
            values = _values(found, key)
            low, middle, high = quartiles(values).tolist()
            shown = units.get(unit, unit)
            name = f"{title} [{shown}]" if shown else title
            cells.append((n, name, values.min(), low, middle, high, values.max(), theirs.get(key)))
    title = f"Over {count(len(next(iter(rows.values()))), 'seed')}; ∞ where the target was never reached"
    return Table("seeds", title, tuple(columns), tuple(cells))


def _panels(rows: dict[int, list[dict[str, Any]]], unit: str) -> list[SeedPanel]:
    papers = {n: paper for n in rows if (paper := published_calibration(n)) is not None}

    def panel(
        heading: str, label: str, key: str, paper: dict[int, float], *, is_log: bool = False
    ) -> SeedPanel:
        return SeedPanel(heading, label, {n: _values(f, key) for n, f in rows.items()}, paper, is_log)

    return [
        panel(
            f"Calls to {USUAL_MSE} {unit}",
            "model calls (paper's count)",
            "calls_to_usual",
            {n: float(p.total) for n, p in papers.items() if p.mse_polished <= USUAL_MSE},
        ),
        panel("Final MSE", f"MSE [{unit}]", "mse_polished", {n: p.mse_polished for n, p in papers.items()},
              is_log=True),
        panel("FMU at the screened point", f"MSE [{unit}]", "mse_screened",
              {n: p.mse_screened for n, p in papers.items()}, is_log=True),
    ]  # fmt: skip


def _title(rows: dict[int, list[dict[str, Any]]]) -> str:
    said = []
    for n, found in rows.items():
        middle = float(quartiles(_values(found, "calls_to_usual"))[1])
        said.append(f"{count(middle)} (n = {n})" if np.isfinite(middle) else f"never (n = {n})")
    return f"Median model calls to {USUAL_MSE}: {listed(said)}"


def _verdict(rows: dict[int, list[dict[str, Any]]], unit: str) -> tuple[Agreement, str]:
    parts, inside = [], []
    for n, found in rows.items():
        paper = published_calibration(n)
        calls, final = (
            quartiles(_values(found, "calls_to_usual")),
            quartiles(_values(found, "mse_polished")),
        )
        told = [count(value) if np.isfinite(value) else "never" for value in calls.tolist()]
        reached = f"{USUAL_MSE} {unit} after {told[1]} calls" if told[1] != "never" else "never there"
        said = (
            f"n = {n}: {reached} (quartiles {told[0]} and {told[2]}), final MSE "
            f"{quantity(float(final[1]), unit)}"
        )
        if paper is not None:
            inside.append(float(final[1]) <= paper.mse_polished)
            said += f" (paper: {paper.total} calls, {paper.mse_polished} {unit})"
        parts.append(said)
    m = len(next(iter(rows.values())))
    agreement: Agreement = "beyond the paper"
    if inside:
        agreement = "agrees" if all(inside) else "agrees in part" if any(inside) else "differs"
    return agreement, (
        f"The paper has one run per size; here are medians over {count(m, 'seed')}. {'; '.join(parts)}. One "
        "run says little: the quartiles show by how much another seed would have changed the paper's row."
    )
