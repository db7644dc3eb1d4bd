"""Sec. 4's outlook: the white-box office, more parameters and slower, calibrated against the same data."""

from dataclasses import asdict
from typing import Any

from simulation.errors import InputError
from studies.paper.plan import Plan
from studies.paper.result import ERROR, SQUARED_ERROR, ItemResult, columns_in
from studies.paper.tuned import tune_sizes
from studies.report.figures_calibration import overview_figure
from studies.report.page import Picture
from studies.report.tables import Table
from studies.report.wording import count, difference_unit, listed, quantity, squared
from studies.stages.adaptive import adaptive_settings, adaptive_stage
from studies.stages.calibrate import calibrate_stage
from studies.stages.guided import are_state_equations_learnt
from studies.stages.pipeline import Study
from studies.stages.results import calibration_record, stored_calibrations
from studies.stages.simulate import train_seed

COUNTERPART = {"office": "office-whitebox-metered", "office-recorded": "office-whitebox-recorded"}
"""The white-box case that is compared with the same data."""

SIMULATIONS_PER_S = 40.0

COLUMNS = (
    ("method", "method", ""),
    ("n_train", "training simulations", ""),
    ("test_mae", "surrogate's test MAE", ERROR),
    ("mse_screened", "MSE by the FMU, screened", SQUARED_ERROR),
    ("mse", "final MSE", SQUARED_ERROR),
    ("total_paper", "calls (paper's count)", ""),
    ("total_honest", "calls in all", ""),
)


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    study = _study(plan)
    profile = study.profile.to_dict()
    return {
        "other_case": study.case.digest,
        "other_measurement": study.case.measurement.digest,
        "n_train": list(plan.budget.seed_sizes),
        "trials": plan.budget.white_box_trials,
        **{name: profile[name] for name in ("tuning", "screening", "polish")},
        "sets": [profile["data"]["n_validation"], profile["data"]["n_test"]],
    }


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    sizes, data = plan.budget.seed_sizes, plan.study.profile.data
    n_rows = max(sizes) + data.n_validation + data.n_test + len(sizes) * plan.study.profile.polish.max_calls
    training = plan.training_s(sizes, {max(sizes): plan.budget.white_box_trials})
    return n_rows / SIMULATIONS_PER_S + training + len(sizes) * plan.screening_s() + 120.0


def run(plan: Plan) -> ItemResult:
    """Calibrate the white box with the paper's method and with the adaptive one."""
    study, trials = _study(plan), {max(plan.budget.seed_sizes): plan.budget.white_box_trials}
    tuned = tune_sizes(study, trials)
    outcomes = {n: calibrate_stage(study, n) for n in plan.budget.seed_sizes}
    learns = are_state_equations_learnt(study.case, None)
    settings = adaptive_settings(
        study.case, max_calls=None, n_parallel=None, target_mse=None, state_equations=learns
    )
    adaptive = adaptive_stage(study, settings, state_equations=learns)
    unit = squared(difference_unit(study.case.outputs[0].unit))
    records = tuple(calibration_record(stored) for stored in stored_calibrations(study))
    rows = {str(n): _row(outcome.summary) for n, outcome in outcomes.items()}
    rows["adaptive"] = {
        "mse": adaptive.summary["mse"],
        "total_paper": adaptive.summary["ledger"]["total_paper"],
        "total_honest": adaptive.summary["ledger"]["total_honest"],
    }
    grey = min((known.mse for known in plan.study.case.references if not known.is_target), default=None)
    p = study.case.parameter_space.n_parameters
    return ItemResult(
        agreement="beyond the paper",
        verdict=_verdict(rows, grey, p, unit),
        numbers={"case": study.case.name, "n_parameters": p, "grey_box_best_known": grey, "rows": rows},
        paper={"statement": "future work: a white-box model of the office (sec. 4, Fig. 10)"},
        tables=(
            Table(
                "whitebox",
                f"{study.case.title}: {p} parameters",
                columns_in(difference_unit(study.case.outputs[0].unit), COLUMNS),
                tuple(_cells(name, row) for name, row in rows.items()),
            ),
        ),
        pictures=(
            Picture(
                "sizes",
                "All calibrations of the white box",
                "MSE by the surrogate, by the FMU at the screened point, and polished, by training-set size.",
                lambda path: overview_figure(records, (), path, mse_unit=unit, footnote=study.label),
            ),
        ),
        n_calls={
            **tuned.n_simulations,
            "screening checks": sum(o.summary["ledger"]["n_screen_checks"] for o in outcomes.values()),
            "polish": sum(o.summary["ledger"]["n_polish"] for o in outcomes.values()),
            "adaptive": rows["adaptive"]["total_paper"],
        },
        work_s=tuned.wall_s + adaptive.wall_s + sum(o.wall_s for o in outcomes.values()),
        seeds={"training design": train_seed(study.profile.seed), "all else": study.profile.seed},
        settings=(
            ("case", study.case.name),
            ("screening", ", ".join(f"{k} {v}" for k, v in asdict(study.profile.screening).items())),
        ),
        metrics={f"mse/{name}": row["mse"] for name, row in rows.items()},
        uses=(
            *tuned.commands(trials),
            f"studies calibrate {study.command} --method paper",
            f"studies calibrate {study.command}",
        ),
    )


def _study(plan: Plan) -> Study:
    name = plan.study.case.name
    if name not in COUNTERPART:
        raise InputError(f"whitebox: there is no white-box case for {name}; give {' or '.join(COUNTERPART)}")
    return plan.other_study(COUNTERPART[name])


def _row(summary: dict[str, Any]) -> dict[str, Any]:
    return {
        "n_train": summary["n_train"],
        "test_mae": summary["surrogate_errors"]["test/mae"],
        "mse_screened": summary["mse_screened"],
        "mse": summary["mse_polished"],
        "total_paper": summary["ledger"]["total_paper"],
        "total_honest": summary["ledger"]["total_honest"],
    }


def _cells(name: str, row: dict[str, Any]) -> tuple[Any, ...]:
    method = "adaptive, no training set" if name == "adaptive" else "surrogate and polish"
    named = {**row, "method": method}
    return tuple(named.get(key) for key, _, _ in COLUMNS)


def _verdict(rows: dict[str, dict[str, Any]], grey: float | None, p: int, unit: str) -> str:
    known = {name: row for name, row in rows.items() if row["mse"] is not None}
    if not known:
        return "No calibration of the white box could be simulated."
    said = [
        f"{quantity(row['mse'], unit)} with {count(row['total_paper'])} calls "
        f"({'adaptive' if name == 'adaptive' else f'n = {name}'})"
        for name, row in known.items()
    ]
    text = (
        f"The paper announces a white-box model as future work and prints nothing of it. Here {p} "
        "parameters of an own white-box office are calibrated against data that it did not generate "
        f"exactly: {listed(said)}."
    )
    if grey is not None:
        text += f" The grey box's best known error on the same days is {quantity(grey, unit)}."
    return text
