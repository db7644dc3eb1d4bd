"""What the terminal says of calibrations from surrogates: errors, costs, and the calibrated parameters."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.console import Column
from studies.physical_model import warn_failed
from studies.report.wording import bound_at, difference_unit, mse_text, significant, squared
from studies.stages.determined import open_in_words, open_note
from studies.stages.guideline import Periods, judge_calibration, show_guideline
from studies.stages.knowledge import show_prior
from studies.stages.pipeline import Outcome, Study
from studies.stages.restriction_shown import show_restriction
from studies.stages.results import calibration_files, most_relevant, n_free_of, read_arrays
from studies.stages.validation import show_validation


def show_calibrations(study: Study, outcomes: list[Outcome], target: float | None) -> None:
    """Print one row per training-set size, as the paper's Table 4, and what it cost."""
    titles = ["n_train", "MAE val", "MAE test", "MSE surrogate", "MSE screened", "gap"]
    titles += ["polish calls", "final MSE", "calls (paper)", "calls (all)"]
    columns = [Column(title, True) for title in titles]
    if target is not None:
        columns.append(Column(f"calls to {target:g}", True))
    rows = []
    for outcome in outcomes:
        found = outcome.summary
        errors, ledger = found["surrogate_errors"], found["ledger"]
        row = [
            found["n_train"],
            significant(errors["val/mae"]),
            significant(errors["test/mae"]),
            mse_text(found["mse_surrogate"]),
            mse_text(found["mse_screened"]),
            mse_text(found["screening_gap"]),
            ledger["n_polish"],
            mse_text(found["mse_polished"]),
            ledger["total_paper"],
            ledger["total_honest"],
        ]
        if target is not None:
            row.append(calls_to(study, found["n_train"], target, n_free_of(found)) or "not reached")
        rows.append(row)
    unit = difference_unit(study.case.outputs[0].unit)
    units = f"MAE of the surrogate in {unit}; MSE in {squared(unit)}; " if unit else ""
    study.console.table(
        f"{study.label}: calibration ({units}MSE screened and final by the FMU)", columns, rows
    )
    for outcome in outcomes:
        warn_failed(study, outcome.summary)
    show_validation(study, outcomes)
    if study.case.note:
        study.console.result(f"Note: {study.case.note}")


def calls_to(study: Study, n_train: int, target: float, n_free: int | None = None) -> int | None:
    """Return the calls, as the paper counts, after which the error was at most the target."""
    from studies.calibration.recorder import History

    arrays = read_arrays(calibration_files(study, n_train, n_free).arrays)
    return History(arrays["history_calls"], arrays["history_mse"]).calls_to(target)


def target_numbers(study: Study, outcomes: list[Outcome], target: float | None) -> dict[str, Any]:
    """Return by training-set size what a target cost, for programs; nothing where none was named."""
    if target is None:
        return {}
    calls = {
        outcome.summary["n_train"]: calls_to(
            study, outcome.summary["n_train"], target, n_free_of(outcome.summary)
        )
        for outcome in outcomes
    }
    return {"target": target, "calls_to_target": calls}


def show_values(study: Study, outcomes: list[Outcome]) -> None:
    """Print the calibrated parameters of the size with the lowest final error, and what judges them."""
    finished = [outcome.summary for outcome in outcomes if _error(outcome) < math.inf]
    if not finished:
        return
    best = min(finished, key=lambda summary: float(summary["mse_polished"]))
    show_parameters(study, best, f"n_train = {best['n_train']}")
    show_prior(study, best, f"n_train = {best['n_train']}")
    show_restriction(study, best, f"n_train = {best['n_train']}")
    show_guideline(study, judged_values(study, best))
    judged = f"--n-train {best['n_train']}{most_relevant(n_free_of(best))}"
    study.console.result(f"How sure it is: studies uncertainty {study.command} {judged}")


def judged_values(study: Study, found: Mapping[str, Any]) -> Periods:
    """Judge a calibration from a surrogate by ASHRAE guideline 14.

    Args:
        study: the study.
        found: its numbers.
    """
    y = read_arrays(calibration_files(study, found["n_train"], n_free_of(found)).arrays)["y_polished"]
    return judge_calibration(study.case, y, found) if np.isfinite(y).all() else {}


def show_parameters(study: Study, numbers: Mapping[str, Any], how: str) -> None:
    """Print calibrated parameters, which of them were fixed, and which the data leave open.

    Args:
        study: the study.
        numbers: a calibration's numbers.
        how: how they were found, in a word.
    """
    found, fixed = numbers["theta"], numbers.get("restriction", {}).get("fixed", {})
    space = study.case.parameter_space
    theta = np.array([found[name] for name in space.names])
    rows = []
    for parameter, value, u in zip(space.parameters, theta, space.to_unit(theta), strict=True):
        bound = bound_at(float(u))
        if parameter.name in fixed:
            note = "fixed"
        elif parameter.name in numbers.get("without_effect", ()):
            # A bound that it happens to lie at says nothing.
            note = "the error hardly depends on it"
        else:
            note = open_note(parameter.name, numbers)
            note = note or (f"at the {bound} bound: widen it?" if bound else "")
        rows.append(
            [
                parameter.name,
                parameter.unit,
                "" if parameter.estimate is None else f"{parameter.estimate:.4g}",
                f"{value:.6g}",
                f"{parameter.lower:.4g} to {parameter.upper:.4g}",
                note,
            ]
        )
    study.console.table(
        f"{study.label}: calibrated parameters ({how})",
        [
            Column("parameter"),
            Column("unit"),
            Column("estimate", True),
            Column("calibrated", True),
            Column("bounds", True),
            Column(""),
        ],
        rows,
    )
    for line in open_in_words(numbers):
        study.console.result(line)


def _error(outcome: Outcome) -> float:
    error = outcome.summary["mse_polished"]
    return math.inf if error is None else float(error)
