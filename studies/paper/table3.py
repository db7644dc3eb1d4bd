"""Tables 2 and 3: optimizers coupled directly with the FMU, beside the paper's calls and errors."""

from dataclasses import replace
from typing import Any

import numpy as np

from simulation.errors import InputError
from studies.console import OnBar
from studies.paper.direct import row_over_seeds, run_direct_row
from studies.paper.direct_crew import OnStart
from studies.paper.direct_row import TITLES, DirectRow, PaperRow, paper_rows, published_row
from studies.paper.plan import DIRECT_CALLS_PER_S, Plan
from studies.paper.published import USUAL_MSE
from studies.paper.result import SQUARED_ERROR, Agreement, ItemResult, columns_in
from studies.report.figures_direct import DirectPoint, direct_figure
from studies.report.page import Picture
from studies.report.tables import Column, Table
from studies.report.wording import count, difference_unit, listed, quantity, squared

MANY = 16
"""Starts of the rows that are repeated over seeds."""

CLOSE_MSE, CLOSE_CALLS = 1.1, 2.0
"""Within these factors of the paper's a row counts as the same."""

COLUMNS = (
    ("row", "method", ""),
    ("objective", "objective", ""),
    ("coordinates", "coordinates", ""),
    ("n_calls", "model calls", ""),
    ("mse", "MSE", SQUARED_ERROR),
    ("mse_median", "median over its starts", SQUARED_ERROR),
    ("wall_s", "work", "s"),
    ("paper_calls", "paper: model calls", ""),
    ("paper_mse", "paper: MSE", "K²"),
)

Found = dict[str, Any]


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    return {
        "rows": [one.row.name for one in _rows(plan)],
        "seeded": [row.name for rows in _seeded(plan).values() for row in rows],
        "own": [row.name for row in _own_rows(plan)],
    }


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    rows = [one.row for one in _rows(plan)] + [row for rows in _seeded(plan).values() for row in rows]
    most: dict[str, int] = {}
    for row in rows:
        # More starts of a series go on from fewer.
        published = published_row(row)
        most[row.series] = max(most.get(row.series, 0), published.n_calls if published else 0)
    return sum(most.values()) / DIRECT_CALLS_PER_S + 10.0


def run_one(plan: Plan, name: str) -> Found:
    """Compute one row alone.

    Raises:
        InputError: no row has this name.
    """
    seed = plan.study.profile.seed
    rows = [one.row for one in paper_rows(seed)] + list(_own_rows(plan))
    rows += [row for group in _seeded(plan).values() for row in group]
    known = {row.name: row for row in rows}
    if name not in known:
        raise InputError(f"--row {name}: there is no such row; there are {', '.join(known)}")
    with plan.study.console.bars() as bars:
        return run_direct_row(plan.study, known[name], _teller(bars, known[name]))


def run(plan: Plan) -> ItemResult:
    """Compute the rows of the budget, in the order of the paper, and some of them with other seeds."""
    study = plan.study
    with study.console.bars() as bars:
        found = [(one, run_direct_row(study, one.row, _teller(bars, one.row))) for one in _rows(plan)]
        own = [run_direct_row(study, row, _teller(bars, row)) for row in _own_rows(plan)]
        seeded = {
            method: row_over_seeds(study, rows, lambda row: _teller(bars, row))
            for method, rows in _seeded(plan).items()
        }
    error_unit = difference_unit(study.case.outputs[0].unit)
    unit = squared(error_unit)
    left_out = [one for one in paper_rows(study.profile.seed) if one not in _rows(plan)]
    agreement, verdict = _verdict([numbers for _, numbers in found], unit)
    if left_out:
        verdict += f" {count(len(left_out), 'row')} of the paper are left to a larger budget."
    references = study.case.references
    points = [_point(numbers) for _, numbers in found]
    tables = [
        Table(
            "table3",
            "Optimizers on the FMU; a row of many starts reports its best",
            columns_in(error_unit, COLUMNS),
            (*(_cells(n) for _, n in found), *(_cells(n) for n in own), *(_unknown(one) for one in left_out)),
        )
    ]
    if seeded:
        tables.append(_seeds_table(seeded, unit))
    all_rows = [numbers for _, numbers in found] + own
    return ItemResult(
        agreement=agreement,
        verdict=verdict,
        numbers={
            "rows": {numbers["name"]: _kept(numbers) for numbers in all_rows},
            "over_seeds": seeded,
            "not_computed": [one.row.name for one in left_out],
        },
        paper={
            "rows": [
                {"title": one.row.title, "n_calls": one.published.n_calls, "mse": one.published.mse}
                for one in paper_rows(study.profile.seed)
                if one.published is not None
            ]
        },
        tables=tuple(tables),
        pictures=(
            Picture(
                "calls-and-error",
                "What a lower error costs",
                "Filled: ours, with the number of starts; hollow: the paper's row, joined to ours by a line.",
                lambda path: direct_figure(
                    points, references, path, title=_title(points, unit), mse_unit=unit, footnote=study.label
                ),
            ),
        ),
        n_calls={
            "rows": sum(numbers["n_calls"] for numbers in all_rows),
            "rows over seeds": int(sum(sum(one["n_calls"]) for one in seeded.values())),
        },
        work_s=sum(numbers["wall_s"] for numbers in all_rows) + sum(one["wall_s"] for one in seeded.values()),
        seeds={
            "starts": study.profile.seed,
            "over seeds": next(iter(seeded.values()))["seeds"] if seeded else [],
        },
        settings=(("rows of the paper", f"{len(found)} of {len(found) + len(left_out)}"),),
        metrics={f"mse/{numbers['name']}": numbers["mse"] for _, numbers in found},
        remarks=(
            "The paper draws starts with 'variance 0.5 (theta+ - theta-)', which has the unit of a standard "
            "deviation; it is read as one here, each parameter truncated at its bounds. Calls are counted at "
            "the model, finite differences included.",
            "The paper's Table 2 says that LS-TRF gets squared residuals; its numbers of calls fit signed "
            "ones, so those stand in the rows, the squared ones beside.",
            *_left_out(plan, left_out),
        ),
        uses=(f"{plan.command('table3')} --row {found[0][1]['name']}", "and so for the other rows"),
    )


def _left_out(plan: Plan, rows: list[PaperRow]) -> tuple[str, ...]:
    if not rows:
        return ()
    named = [f"{one.row.title}: {one.row.name}" for one in rows]
    command = f"{plan.command('table3')} --row NAME"
    return (f"Not computed with this budget ({'; '.join(named)}). One of them alone: {command}",)


def _rows(plan: Plan) -> tuple[PaperRow, ...]:
    most = plan.budget.max_row_calls
    return tuple(
        one
        for one in paper_rows(plan.study.profile.seed)
        if one.published is None or one.published.n_calls <= most
    )


def _own_rows(plan: Plan) -> tuple[DirectRow, ...]:
    """Return LS-TRF with squared residuals, and with signed ones in the case's own scales."""
    trf = next(one.row for one in paper_rows(plan.study.profile.seed) if one.row.method == "ls-trf")
    rows = [replace(trf, objective="squared"), replace(trf, coordinates="log")]
    if plan.budget.max_row_calls >= 3486:
        rows += [replace(row, start=MANY) for row in rows]
    return tuple(rows)


def _seeded(plan: Plan) -> dict[str, list[DirectRow]]:
    """Return the local methods with 16 starts, each with the seeds of the robust statistics."""
    return {
        one.row.method: [replace(one.row, seed=seed) for seed in plan.seeds]
        for one in paper_rows(plan.study.profile.seed)
        if one.row.n_starts == MANY
        and one.published is not None
        and one.published.n_calls <= plan.budget.max_seeded_calls
    }


def _teller(bars: OnBar, row: DirectRow) -> OnStart:
    return lambda n_done, n_starts: bars(f"{row.title}, seed {row.seed}", n_done, n_starts)


def _kept(numbers: Found) -> Found:
    """Return what of a row's numbers is worth exporting."""
    return {key: part for key, part in numbers.items() if key not in ("digest", "versions", "history")}


def _cells(numbers: Found) -> tuple[Any, ...]:
    row, paper = numbers["row"], numbers["paper"]
    is_papers = row["objective"] != "squared" and row["coordinates"] == "physical"
    return (
        numbers["title"],
        row["objective"],
        row["coordinates"],
        numbers["n_calls"],
        numbers["mse"],
        numbers["mse_median"],
        numbers["wall_s"],
        paper["n_calls"] if paper and is_papers else None,
        paper["mse"] if paper and is_papers else None,
    )


def _unknown(one: PaperRow) -> tuple[Any, ...]:
    assert one.published is not None, "only rows of the paper are left out for their calls"
    nothing = (None, None, None, None)
    row = one.row
    return row.title, row.objective, row.coordinates, *nothing, one.published.n_calls, one.published.mse


def _seeds_table(seeded: dict[str, Found], unit: str) -> Table:
    columns = [Column("method", "method, 16 starts"), Column("quantity", "quantity")]
    columns += [Column("q25", "lower quartile"), Column("median", "median"), Column("q75", "upper quartile")]
    columns += [Column("lowest", "lowest"), Column("highest", "highest")]
    rows: list[tuple[Any, ...]] = []
    for method, found in seeded.items():
        title = next(t for name, t in TITLES.items() if name == method)
        for key, name in (("mse", f"MSE [{unit}]"), ("n_calls", "model calls")):
            values = found[key]
            rows.append((title, name, *found[f"{key}_quartiles"], min(values), max(values)))
    n = len(next(iter(seeded.values()))["seeds"])
    return Table(
        "over-seeds", f"The local methods with 16 starts over {count(n, 'seed')}", tuple(columns), tuple(rows)
    )


def _point(numbers: Found) -> DirectPoint:
    paper = numbers["paper"]
    method = numbers["row"]["method"]
    return DirectPoint(
        method=next(title for name, title in TITLES.items() if name == method),
        n_starts=numbers["n_starts"],
        n_calls=numbers["n_calls"],
        mse=numbers["mse"],
        paper_calls=paper["n_calls"] if paper else None,
        paper_mse=paper["mse"] if paper else None,
    )


def _title(points: list[DirectPoint], unit: str) -> str:
    best = min(points, key=lambda point: point.mse)
    return (
        f"The lowest error on the FMU alone, {quantity(best.mse, unit)}, took {count(best.n_calls)} calls "
        f"({best.method})"
    )


def _verdict(found: list[Found], unit: str) -> tuple[Agreement, str]:
    compared = [numbers for numbers in found if numbers["paper"] is not None]
    if not compared:
        return "beyond the paper", "No row of the paper is within this budget."
    no_worse = [n for n in compared if n["mse"] <= CLOSE_MSE * n["paper"]["mse"]]
    ratios = np.array([n["n_calls"] / n["paper"]["n_calls"] for n in compared])
    near = int(np.sum((ratios <= CLOSE_CALLS) & (ratios >= 1.0 / CLOSE_CALLS)))
    m = len(compared)
    agreement: Agreement = "agrees" if len(no_worse) == m else "agrees in part" if no_worse else "differs"
    worse = [n["title"] for n in compared if n not in no_worse]
    cheapest = [n for n in compared if n["mse"] <= USUAL_MSE]
    parts = [
        f"{len(no_worse)} of {m} rows end at the paper's error or below (within 10 %), {near} of {m} took "
        "between half and twice its calls."
    ]
    if worse:
        parts.append(f"Ours end higher: {listed(worse)}.")
    if cheapest:
        best = min(cheapest, key=lambda n: n["n_calls"])
        parts.append(
            f"The cheapest row at {USUAL_MSE} {unit} or below is {best['title']} with "
            f"{count(best['n_calls'])} calls."
        )
    parts.append(
        "Differences are to be expected: the paper does not print tolerances and starts, and its FMU "
        "integrates with a tolerance of its own, ours steps exactly."
    )
    return agreement, " ".join(parts)
