"""Fig. 4 and sec. 2.3: do the training trajectories enclose the measurement, do the samples fill the box."""

from typing import Any

import numpy as np

from simulation.errors import InputError
from studies.paper.plan import SIMULATIONS_PER_S, Plan
from studies.paper.result import ItemResult
from studies.report import captions
from studies.report.figures_data import coverage_figure
from studies.report.findings import enclosed_fraction, good_rows, strongest_correlation
from studies.report.page import Picture
from studies.report.tables import Column, Table
from studies.report.wording import count, difference_unit, percent, quantity, shown_unit
from studies.stages.results import coverage_set, measured_series, parameter_box
from studies.stages.simulate import simulate_stage, train_seed


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    return {"n_train": max(plan.budget.n_train)}


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    data = plan.study.profile.data
    return (max(data.n_train) + data.n_validation + data.n_test) / SIMULATIONS_PER_S + 5.0


def run(plan: Plan) -> ItemResult:
    """Simulate the training set and look at its first 256 rows."""
    study = plan.study
    simulated = simulate_stage(study)
    coverage = coverage_set(study)
    if coverage is None or not len(good_rows(coverage)):
        raise InputError(
            f"no training simulation of {study.label} succeeded; type: studies check {study.command}"
        )
    measured, box = measured_series(study.case), parameter_box(study.case)
    good, unit = good_rows(coverage), shown_unit(study.case.outputs[0].unit)
    enclosed = enclosed_fraction(measured, coverage)
    above = float(np.mean(measured.measurement.differences(good, 0) > 0.0))
    spread = float(good[:, :, 0].std(axis=0).mean())
    strongest = strongest_correlation(coverage)
    known = np.isfinite(box.estimate).all()
    low = np.nanmean(coverage.theta < box.estimate, axis=0)
    rows = tuple(
        (name, unit_, float(box.lower[i]), float(box.estimate[i]), float(box.upper[i]), float(low[i]))
        for i, (name, unit_) in enumerate(zip(box.names, box.units, strict=True))
    )
    columns = (
        Column("parameter", "parameter"),
        Column("unit", "unit"),
        Column("lower", "lower bound"),
        Column("estimate", "estimate"),
        Column("upper", "upper bound"),
        Column("below_estimate", "samples below the estimate"),
    )
    temperature = difference_unit(study.case.outputs[0].unit)
    verdict = (
        "The paper's figure shows the measurement inside the bundle of 256 trajectories, a first check that "
        f"the model can reproduce it. Here {percent(enclosed)} of the measured values lie inside "
        f"{count(len(good))} trajectories, with {percent(above)} of all simulated values above the measured "
        f"one and a standard deviation over the set of {quantity(spread, temperature)} on average."
    )
    if strongest is not None:
        verdict += (
            f" No pair of sampled parameters correlates by more than {abs(strongest[0]):.2f}: "
            "the samples fill the box as independent draws do."
        )
    return ItemResult(
        agreement="agrees" if enclosed > 0.99 else "agrees in part" if enclosed > 0.8 else "differs",
        verdict=verdict,
        numbers={
            "n": len(coverage.y),
            "n_failed": len(coverage.y) - len(good),
            "enclosed_share": enclosed,
            "share_of_simulated_values_above": above,
            "mean_standard_deviation": spread,
            "lowest": float(good[..., 0].min()),
            "highest": float(good[..., 0].max()),
            "unit": unit,
            "strongest_correlation": None if strongest is None else strongest[0],
            "share_of_samples_below_estimate": dict(zip(box.names, low.tolist(), strict=True)),
        },
        paper={"n": 256, "statement": "the measurement lies within the training trajectories (Fig. 4)"},
        tables=(Table("samples", "The box and its samples", columns, rows),),
        pictures=(
            Picture(
                "trajectories",
                "Training trajectories and the measurement",
                captions.coverage_caption(measured, coverage),
                lambda path: coverage_figure(measured, coverage, path, footnote=study.label),
            ),
        ),
        n_calls={"training set": len(coverage.y)},
        work_s=simulated.wall_s,
        seeds={"training design": train_seed(study.profile.seed)},
        metrics={"coverage/enclosed": enclosed},
        remarks=(
            "Bounds of a fifth and five times the estimate, sampled uniformly (Eq. 2), put five sixths of "
            "the samples above the estimate: the last column of the table counts the others.",
        )
        if known
        else (),
        uses=(
            f"studies simulate {study.command} ({count(simulated.summary['n_simulations'], 'row')} for all "
            "sizes)",
        ),
    )
