"""Fig. 8 and sec. 3.3.2: is the calibration unique, which parameters compensate each other, and why."""

from typing import Any

from numpy.typing import NDArray

from studies.paper.direct import direct_folder
from studies.paper.plan import DIRECT_CALLS_PER_S, Plan
from studies.paper.result import Agreement, ItemResult
from studies.paper.uniqueness import (
    BEST_PAPER,
    BEST_SHARE,
    MEAN_PAPER,
    N_LARGEST,
    run_uniqueness,
    uniqueness_rows,
)
from studies.report.figures_uniqueness import (
    Bundle,
    BundlePanel,
    identifiability_figure,
    parallel_coordinates_figure,
)
from studies.report.page import Picture
from studies.report.tables import Column, Table
from studies.report.wording import count, difference_unit, listed, percent, quantity, squared
from studies.stages.results import read_arrays

CALLS_PER_START = 750
CLOSE = 1.1
"""Within this factor the best 5 % count as good as the paper's."""

KINDS = {
    "paper": "signed residuals, physical parameters, the paper's tolerance",
    "squared": "squared residuals",
    "patient": "own scales, SciPy's tolerance",
}

Found = dict[str, Any]


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    rows = uniqueness_rows(plan.study.profile.seed, plan.budget.max_starts)
    return {"rows": {kind: row.name for kind, row in rows.items()}}


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    return len(KINDS) * plan.budget.max_starts * CALLS_PER_START / DIRECT_CALLS_PER_S


def run(plan: Plan) -> ItemResult:
    """Start LS-TRF from many points in three ways, cluster the optima and differentiate at the best one."""
    study = plan.study
    rows = uniqueness_rows(study.profile.seed, plan.budget.max_starts)
    found: dict[str, Found] = {}
    with study.console.bars() as bars:
        for kind, row in rows.items():

            def tell(n_done: int, n_starts: int, kind: str = kind) -> None:
                bars(KINDS[kind], n_done, n_starts)

            found[kind] = run_uniqueness(study, row, tell)
    arrays = read_arrays(direct_folder(study) / f"{rows['paper'].name}.uniqueness.npz")
    patient = read_arrays(direct_folder(study) / f"{rows['patient'].name}.uniqueness.npz")
    names = study.case.parameter_space.names
    unit = squared(difference_unit(study.case.outputs[0].unit))
    agreement, verdict = _verdict(found, unit)
    local = found["patient"]["identifiability"]
    return ItemResult(
        agreement=agreement,
        verdict=verdict,
        numbers={kind: _kept(numbers) for kind, numbers in found.items()},
        paper={"mse_mean": MEAN_PAPER, "mse_best_5_percent": BEST_PAPER, "in_3_largest_clusters": [110, 256]},
        tables=(_starts_table(found, unit), _parameters_table(found, names)),
        pictures=(
            Picture(
                "optima",
                "The optima of the paper's starts",
                _clusters_caption(found["paper"], unit),
                lambda path: parallel_coordinates_figure(
                    names, _panels(arrays, found["paper"]), path, title=_title(found["paper"], unit),
                    footnote=study.label,
                ),
            ),
            Picture(
                "identifiability",
                "What the data determine at the best optimum",
                _local_caption(local),
                lambda path: identifiability_figure(
                    names,
                    patient["local_correlation"],
                    patient["local_spread"],
                    patient["singular_values"],
                    path,
                    title=f"The data determine {local['n_determined_directions']} of {len(names)} "
                    f"combinations of parameters, and {len(local['determined'])} parameters",
                    footnote=study.label,
                ),
            ),
        ),
        n_calls={f"starts, {KINDS[kind]}": numbers["n_calls"] for kind, numbers in found.items()},
        work_s=sum(numbers["wall_s"] for numbers in found.values()),
        seeds={"starts and clusters": study.profile.seed},
        settings=(
            ("starts", str(plan.budget.max_starts)),
            ("centroids", str(len(found["paper"]["clusters"]))),
        ),
        metrics={f"mse_mean/{kind}": numbers["mse_mean"] for kind, numbers in found.items()},
        uses=tuple(f"LS-TRF, {KINDS[kind]}: {row.name}" for kind, row in rows.items()),
    )  # fmt: skip


def _kept(numbers: Found) -> Found:
    return {key: part for key, part in numbers.items() if key not in ("digest", "command")}


def _panels(arrays: dict[str, NDArray[Any]], found: Found) -> list[BundlePanel]:
    u, labels = arrays["u"], arrays["labels"]
    largest = tuple(
        Bundle(f"cluster {k + 1}", u[labels == k]) for k in range(min(N_LARGEST, len(found["clusters"])))
    )
    n = sum(len(bundle.u) for bundle in largest)
    best = Bundle(f"best {percent(BEST_SHARE)}", u[arrays["best"]])
    return [
        BundlePanel(f"(a) The {len(largest)} largest clusters, {n} of {len(u)} optima", largest),
        BundlePanel("(b) The best optima", (best,)),
    ]


def _starts_table(found: dict[str, Found], unit: str) -> Table:
    columns = (
        Column("kind", "starts"),
        Column("n_calls", "model calls"),
        Column("mse_best", "best MSE", unit),
        Column("mse_best_5_percent", "best 5 %", unit),
        Column("mse_median", "median", unit),
        Column("mse_mean", "mean", unit),
        Column("n_at_best", "within 1 % of the best"),
    )
    keys = [column.key for column in columns[1:]]
    rows = [(KINDS[kind], *(numbers[key] for key in keys)) for kind, numbers in found.items()]
    rows.append(("paper", None, None, BEST_PAPER, None, MEAN_PAPER, None))
    title = f"{count(found['paper']['n_starts'])} starts of LS-TRF"
    return Table("starts", title, columns, tuple(rows))


def _parameters_table(found: dict[str, Found], names: tuple[str, ...]) -> Table:
    local = found["patient"]["identifiability"]
    columns = (
        Column("parameter", "parameter"),
        Column("best", "at the best optimum"),
        Column("spread", "standard deviation / range"),
        Column("range_of_best", "span of the best 5 % / range"),
        Column("determined", "determined"),
    )
    rows = tuple(
        (
            name,
            local["theta"][name],
            local["spread"][name],
            found["patient"]["spread_over_best"][name],
            "yes" if name in local["determined"] else "no",
        )
        for name in names
    )
    return Table("parameters", "What the data say of each parameter, patient starts", columns, rows)


def _title(found: Found, unit: str) -> str:
    return (
        f"{count(found['n_starts'])} starts end at {quantity(found['mse_best'], unit)} to a mean of "
        f"{quantity(found['mse_mean'], unit)}"
    )


def _clusters_caption(found: Found, unit: str) -> str:
    largest = found["clusters"][:N_LARGEST]
    said = [f"{one['size']} optima, median {quantity(one['mse_median'], unit)}" for one in largest]
    return f"The largest clusters: {listed(said)}. Each line is one optimum, from lower to upper bound."


def _local_caption(local: Found) -> str:
    pairs = [pair["in_words"] for pair in local["pairs"][:6]]
    missing = listed(local["not_determined"]) or "none"
    return (
        f"At the best optimum, from the Jacobian. Pairs whose estimates compensate each other: "
        f"{'; '.join(pairs) or 'none'}. Not determined by the data alone: {missing}."
    )


def _verdict(found: dict[str, Found], unit: str) -> tuple[Agreement, str]:
    paper, patient = found["paper"], found["patient"]
    best, mean = paper["mse_best_5_percent"], paper["mse_mean"]
    good = best <= CLOSE * BEST_PAPER
    spread = mean > 1.5 * best
    pairs = [pair["in_words"] for pair in paper["pairs_over_optima"][:4]]
    local = [pair["in_words"] for pair in patient["identifiability"]["pairs"][:4]]
    n = patient["n_starts"]
    one_minimum = patient["n_at_best"] > 0.5 * n
    parts = [
        f"The best 5 % of {count(paper['n_starts'])} starts end at {quantity(best, unit)} on average (paper: "
        f"{BEST_PAPER}), all of them at {quantity(mean, unit)} (paper: {MEAN_PAPER}).",
        f"Over the good optima these move together: {'; '.join(pairs) or 'no pair'}. The Jacobian at the "
        f"best optimum names {'; '.join(local) or 'no pair'}: the data determine their combination alone. "
        "The paper names cExt1 against rExt2.",
        f"With SciPy's tolerance and the parameters' own scales {patient['n_at_best']} of {n} starts end "
        f"within 1 % of {quantity(patient['mse_best'], unit)}",
    ]
    parts[-1] += (
        ": most of what the paper reads as local minima are searches that stopped early in a long flat "
        "valley."
        if one_minimum
        else ": even patient searches end at different errors, so there is more than one valley."
    )
    agreement: Agreement = "agrees" if good and spread else "agrees in part" if good or spread else "differs"
    return agreement, " ".join(parts)
