"""Fig. 5: Sobol indices of all parameters over time, with confidence intervals narrow enough to rank them."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.paper.plan import SIMULATIONS_PER_S, Plan
from studies.paper.published import N_IMPORTANT
from studies.paper.result import Agreement, ItemResult, item_folder
from studies.physical_model import open_physical_model
from studies.report import captions
from studies.report.figures_sensitivity import sensitivity_figure
from studies.report.page import Picture
from studies.report.tables import Column, Table
from studies.report.wording import count, listed, percent
from studies.sensitivity import SobolIndices, mean_over_time, sobol_indices

WORKING_H = (8.0, 20.0)
"""Hours that count as day. [h]"""

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
    order = [indices.names[i] for i in indices.order()]
    first, total = mean_over_time(indices.first_order[:, 0]), mean_over_time(indices.total_order[:, 0])
    daily = daily_course(indices.time, indices.first_order[:, 0], begin_h=study.case.window_d[0] * 24.0)
    widest = float(np.nanmax(indices.first_order_ci))
    important = order[: min(N_IMPORTANT, len(order))]
    agreement, verdict = _verdict(indices, order, daily, widest)
    half = mean_over_time(indices.first_order_ci[:, 0]), mean_over_time(indices.total_order_ci[:, 0])
    columns = [
        "mean_first",
        "ci_first",
        "mean_total",
        "ci_total",
        "lowest",
        "lowest_h",
        "highest",
        "highest_h",
    ]
    titles = ["first order", "± 95 %", "total order", "± 95 %"]
    titles += ["lowest of the day", "at hour", "highest of the day", "at hour"]
    courses = [daily.lowest, daily.lowest_h, daily.highest, daily.highest_h]
    values = np.column_stack([first, half[0], total, half[1], *courses])[list(indices.order())]
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
            "daily_course": {row[0]: dict(zip(columns[4:], row[5:], strict=True)) for row in rows},
            "n_base": indices.n_base,
            "n_dropped_blocks": indices.n_dropped,
        },
        paper={"statement": "UWin and rExt1 become less important during daytime (sec. 3.1)"},
        tables=(
            Table(
                "indices",
                f"Sobol indices of {indices.output_names[0]}, averaged over time; its course of a "
                "mean day is that of the window's second half",
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
                f"at most ±{widest:.3f} wide. {captions.sensitivity_caption(indices)}",
                lambda path: sensitivity_figure(indices, path, footnote=study.label),
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


@dataclass(frozen=True)
class DailyCourse:
    """Extremes of a mean day, for each of p parameters; each of shape (p,).

    Attributes:
        lowest: Lowest value. [1]
        lowest_h: When. [h of the day]
        highest: Highest value. [1]
        highest_h: When. [h of the day]
    """

    lowest: FloatArray
    lowest_h: FloatArray
    highest: FloatArray
    highest_h: FloatArray


def daily_course(time: FloatArray, values: FloatArray, *, begin_h: float) -> DailyCourse:
    """Average the second half of series, where the start is forgotten, by the hour of the day.

    Args:
        time: Times. Shape (t,). [s]
        values: Series. Shape (t, p). [1]
        begin_h: Hour of the day at the first time. [h]
    """
    half = len(time) // 2
    hour = np.floor((begin_h + (time - time[0]) / 3600.0) % 24.0)[half:]
    hours = np.unique(hour)
    course = np.array([mean_over_time(values[half:][hour == one]) for one in hours])
    known = np.where(np.isfinite(course), course, 0.0)
    return DailyCourse(
        lowest=known.min(axis=0),
        lowest_h=hours[known.argmin(axis=0)],
        highest=known.max(axis=0),
        highest_h=hours[known.argmax(axis=0)],
    )


def _verdict(
    indices: SobolIndices, order: list[str], daily: DailyCourse, widest: float
) -> tuple[Agreement, str]:
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
        less.append(bool(WORKING_H[0] <= daily.lowest_h[i] < WORKING_H[1]))
        parts.append(
            f"{name} goes from {percent(float(daily.highest[i]))} at {daily.highest_h[i]:.0f} h to "
            f"{percent(float(daily.lowest[i]))} at {daily.lowest_h[i]:.0f} h"
        )
    agreement: Agreement = "agrees" if all(less) else "agrees in part" if any(less) else "differs"
    return agreement, (
        f"{said} The paper says that UWin and rExt1 matter less by day, when the room is heated: "
        f"{listed(parts)}. It prints no number and names its six in no text, so the ranking itself cannot be "
        "compared."
    )
