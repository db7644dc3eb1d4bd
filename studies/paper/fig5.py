"""Fig. 5: Sobol indices of all parameters over time, with confidence intervals narrow enough to rank them."""

import time
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.paper.plan import SIMULATIONS_PER_S, Plan
from studies.paper.published import N_IMPORTANT
from studies.paper.result import ItemResult, item_folder
from studies.physical_model import open_physical_model
from studies.report import captions
from studies.report.contents import Picture
from studies.report.figures_indices import indices_over_time_figure
from studies.report.figures_sensitivity import sensitivity_figure
from studies.report.findings import mean_over_time
from studies.report.records import SensitivityRecord
from studies.report.tables import Column, Table
from studies.report.wording import count, listed, percent
from studies.sensitivity import SobolIndices, sobol_indices
from studies.stages.pipeline import Study

DAY_H = (6.0, 18.0)
PASSIVE = ("UWin", "rExt1")
"""Parameters of the building itself that the paper says matter less while it is heated, by day."""

FILE = "indices.npz"


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    return {"n_base": plan.budget.n_base, "n_resamples": plan.budget.n_resamples}


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    return _n_rows(plan) / (2.0 * SIMULATIONS_PER_S) + 5.0


def run(plan: Plan) -> ItemResult:
    """Ask the FMU for Saltelli's sample; its rows are used once and not stored."""
    study, budget = plan.study, plan.budget
    started = time.perf_counter()
    with (
        open_physical_model(study) as model,
        study.console.progress("simulations", _n_rows(plan)) as advance,
    ):
        indices = sobol_indices(
            model.unstored,
            n_base=budget.n_base,
            seed=study.profile.seed,
            n_resamples=budget.n_resamples,
            on_progress=advance,
        )
    work_s = time.perf_counter() - started
    file = item_folder(study, "fig5") / FILE
    indices.save(file)
    record = _record(indices)
    order = [indices.names[i] for i in indices.order()]
    first, total, by_day, by_night = _means(study, indices)
    widest = float(np.nanmax(indices.first_order_ci))
    important = order[: min(N_IMPORTANT, len(order))]
    agreement, verdict = _verdict(indices, order, by_day, by_night, widest)
    half = mean_over_time(indices.first_order_ci[:, 0]), mean_over_time(indices.total_order_ci[:, 0])
    columns = ["mean_first", "ci_first", "mean_total", "ci_total", "first_by_day", "first_by_night"]
    titles = ["first order", "± 95 %", "total order", "± 95 %", "first order by day", "first order by night"]
    values = np.column_stack([first, half[0], total, half[1], by_day, by_night])[list(indices.order())]
    rows = tuple((name, *row) for name, row in zip(order, values.tolist(), strict=True))
    return ItemResult(
        agreement=agreement,
        verdict=verdict,
        numbers={
            "order": order,
            "important": important,
            "mean_first_order": {row[0]: row[1] for row in rows},
            "mean_total_order": {row[0]: row[3] for row in rows},
            "mean_half_width": {row[0]: row[2] for row in rows},
            "widest_half_width_at_any_step": widest,
            "sum_of_mean_first_order": float(np.nansum(first)),
            "first_order_by_day": {row[0]: row[5] for row in rows},
            "first_order_by_night": {row[0]: row[6] for row in rows},
            "n_base": indices.n_base,
            "n_dropped_blocks": indices.n_dropped,
        },
        paper={"statement": "UWin and rExt1 become less important during daytime (sec. 3.1)"},
        tables=(
            Table(
                "indices",
                f"Sobol indices of {indices.output_names[0]}, averaged over time; day is 6 to 18 h",
                (
                    Column("parameter", "parameter"),
                    *(Column(key, title) for key, title in zip(columns, titles, strict=True)),
                ),
                rows,
            ),
        ),
        pictures=(
            Picture(
                "over-time",
                "Each parameter's index over time",
                f"Bands are 95 % confidence intervals from {count(budget.n_resamples)} bootstrap samples, "
                f"at most ±{widest:.3f} wide. Most influential by mean first order: {listed(important)}.",
                lambda path: indices_over_time_figure(record, path, footnote=study.label),
            ),
            Picture(
                "stacked",
                "Shares of the variance",
                captions.sensitivity_caption(record),
                lambda path: sensitivity_figure(record, path, footnote=study.label),
            ),
        ),
        n_calls={"Saltelli's sample": indices.n_calls},
        work_s=work_s,
        seeds={"Saltelli's sample and bootstrap": study.profile.seed},
        settings=(("Saltelli blocks", count(indices.n_base)), ("important parameters", ", ".join(important))),
        metrics={f"first_order/{name}": mean for name, mean, *_ in rows},
        uses=(f"studies sensitivity {study.command} (the same with the profile's sample)",),
        files=(file,),
    )


def _n_rows(plan: Plan) -> int:
    return plan.budget.n_base * (plan.study.case.parameter_space.n_parameters + 2)


def _record(indices: SobolIndices) -> SensitivityRecord:
    return SensitivityRecord(
        time=indices.time,
        names=indices.names,
        output_names=indices.output_names,
        first_order=indices.first_order,
        total_order=indices.total_order,
        first_order_ci=indices.first_order_ci,
        total_order_ci=indices.total_order_ci,
        n_calls=indices.n_calls,
        model="the FMU",
    )


def _means(study: Study, indices: SobolIndices) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return mean first order, mean total order, mean first order by day and by night, each of shape (p,)."""
    begin_h = study.case.window_d[0] * 24.0
    hour = (begin_h + (indices.time - indices.time[0]) / 3600.0) % 24.0
    by_day = (hour >= DAY_H[0]) & (hour < DAY_H[1])
    first, total = indices.first_order[:, 0], indices.total_order[:, 0]
    nowhere = np.full(first.shape[1], np.nan)
    return (
        mean_over_time(first),
        mean_over_time(total),
        mean_over_time(first[by_day]) if by_day.any() else nowhere,
        mean_over_time(first[~by_day]) if not by_day.all() else nowhere,
    )


def _verdict(
    indices: SobolIndices, order: list[str], by_day: FloatArray, by_night: FloatArray, widest: float
) -> tuple[Any, str]:
    important = order[: min(N_IMPORTANT, len(order))]
    said = f"By mean first order the six most important are {listed(important)}"
    if len(order) > len(important):
        means = dict(zip(indices.names, indices.mean_first_order()[0], strict=True))
        sixth, seventh = means[important[-1]], means[order[len(important)]]
        said += f"; the sixth explains {percent(float(sixth))} alone, the seventh {percent(float(seventh))}"
    said += f". No confidence interval at any step is wider than ±{widest:.3f}."
    known = [name for name in PASSIVE if name in indices.names]
    if len(known) < len(PASSIVE):
        return "beyond the paper", f"{said} The paper's statement is about its office alone."
    parts, less = [], []
    for name in known:
        i = indices.names.index(name)
        less.append(bool(by_day[i] < by_night[i]))
        parts.append(
            f"{name} explains {percent(float(by_day[i]))} by day and {percent(float(by_night[i]))} by night"
        )
    agreement = "agrees" if all(less) else "agrees in part" if any(less) else "differs"
    return agreement, (
        f"{said} The paper says that UWin and rExt1 matter less by day, when the room is heated: "
        f"{listed(parts)}. It prints no number and names its six in no text, so the ranking itself cannot be "
        "compared."
    )
