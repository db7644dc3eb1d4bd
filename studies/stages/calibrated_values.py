"""The answer itself on the terminal: what the parameters are after calibration, and which lie at a bound."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.console import Column
from studies.stages.guideline import Periods, judge_calibration, show_guideline
from studies.stages.knowledge import show_prior
from studies.stages.pipeline import Outcome, Study
from studies.stages.results import calibration_files, read_arrays

AT_BOUND = 0.01
"""Closer to a bound than this share of the range, in the calibration's coordinates, is at the bound."""


def show_values(study: Study, outcomes: list[Outcome]) -> None:
    """Print the calibrated parameters of the size with the lowest final error."""
    finished = [outcome.summary for outcome in outcomes if _error(outcome) < math.inf]
    if not finished:
        return
    best = min(finished, key=lambda summary: float(summary["mse_polished"]))
    show_parameters(study, best["theta"], f"n_train = {best['n_train']}")
    show_prior(study, best, f"n_train = {best['n_train']}")
    show_guideline(study, judged_values(study, best))


def judged_values(study: Study, found: Mapping[str, Any]) -> Periods:
    """Judge a calibration from a surrogate by ASHRAE guideline 14.

    Args:
        study: the study.
        found: its numbers.
    """
    y = read_arrays(calibration_files(study, found["n_train"]).arrays)["y_polished"]
    return judge_calibration(study.case, y, found) if np.isfinite(y).all() else {}


def show_parameters(study: Study, found: Mapping[str, float], how: str) -> None:
    """Print calibrated parameters.

    Args:
        study: the study.
        found: values by name. [per parameter]
        how: how they were found, in a word.
    """
    space = study.case.parameter_space
    theta = np.array([found[name] for name in space.names])
    rows = []
    for parameter, value, u in zip(space.parameters, theta, space.to_unit(theta), strict=True):
        bound = "lower" if u < AT_BOUND else "upper" if u > 1.0 - AT_BOUND else ""
        rows.append(
            [
                parameter.name,
                parameter.unit,
                "" if parameter.estimate is None else f"{parameter.estimate:.4g}",
                f"{value:.6g}",
                f"{parameter.lower:.4g} to {parameter.upper:.4g}",
                f"at the {bound} bound: widen it?" if bound else "",
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


def _error(outcome: Outcome) -> float:
    error = outcome.summary["mse_polished"]
    return math.inf if error is None else float(error)
