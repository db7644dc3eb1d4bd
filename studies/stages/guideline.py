"""ASHRAE guideline 14 beside a calibration: on the calibrated part and on the one that it did not see."""

from collections.abc import Mapping
from typing import Any

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.time_unit import period_text
from studies.report.guideline14 import Judged, guideline_sentence, judge, judged
from studies.stages.pipeline import Study

Periods = dict[str, tuple[Judged, ...]]


def judge_calibration(case: Case, y: FloatArray, found: Mapping[str, Any]) -> Periods:
    """Judge what a calibration came to.

    Args:
        case: the case.
        y: its trajectory over the calibrated window, finite. Shape (t, k). [per output]
        found: its numbers.

    Returns:
        The verdicts by period: "calibrated" and, where the case has one, "validation".
    """
    units = [output.unit for output in case.outputs]
    periods = {"calibrated": judge(case.measurement, units, y)}
    if case.validation is not None:
        last = list(found["validation"]["points"].values())[-1]
        periods["validation"] = tuple(
            judged(case.validation.measurement, k, unit, fit["cv_rmse"], fit["nmbe"])
            for k, (unit, fit) in enumerate(zip(units, last["outputs"].values(), strict=False))
        )
    return periods


def guideline_numbers(periods: Periods) -> dict[str, Any]:
    """Return the verdicts as plain values, for the document of a command."""
    return {name: [one.to_dict() for one in found] for name, found in periods.items()}


def show_guideline(study: Study, periods: Periods) -> None:
    """Print the verdicts; in one line where nothing can be judged."""
    case = study.case
    days = {"calibrated": case.window_d}
    if case.validation is not None:
        days["validation"] = case.validation.window_d
    if not periods:
        return
    if all(one.limits is None for one in periods["calibrated"]):
        study.console.result(guideline_sentence(periods["calibrated"]))
        return
    for name, found in periods.items():
        if found:
            study.console.result(f"On {period_text(days[name])} ({name}): {guideline_sentence(found)}")
