"""What the terminal says of a calibration of the most relevant parameters."""

from collections.abc import Mapping
from typing import Any

from studies.console import Column
from studies.paths import size_name
from studies.report.records import CalibrationRecord
from studies.report.restricted import restriction_sentences
from studies.report.wording import MISSING, difference_unit, percent, squared
from studies.stages.pipeline import Study
from studies.stages.results import ADAPTIVE, calibration_record, restricted, stored_calibration


def show_restriction(study: Study, found: Mapping[str, Any], how: str) -> None:
    """Print what was fixed and what that cost; nothing for a calibration of all parameters.

    Args:
        study: the study.
        found: the calibration's numbers.
        how: how it was found, in a word.
    """
    if "restriction" not in found:
        return
    told, console = found["restriction"], study.console
    gains = {} if told["check"] is None else told["check"]["gain_alone"]
    rows = [
        [
            one.name,
            one.unit,
            f"{told['fixed'][one.name]:.6g}",
            told["why"][one.name],
            _share(told["shares"][one.name]),
            _share(gains.get(one.name)),
        ]
        for one in study.case.parameter_space.parameters
        if one.name in told["fixed"]
    ]
    columns = [Column("parameter"), Column("unit"), Column("fixed at", True), Column("which is")]
    columns += [Column("share", True), Column("gain if free", True)]
    console.table(f"{study.label}: parameters fixed as least relevant ({how})", columns, rows)
    method = ADAPTIVE if found.get("method") == ADAPTIVE else size_name(found["n_train"])
    names = (method + restricted(told["n_free"]), method)
    this, of_all = (_record(study, name) for name in names)
    if this is not None:
        unit = squared(difference_unit(study.case.outputs[0].unit))
        for sentence in restriction_sentences(this, of_all, unit):
            console.result(sentence)


def _record(study: Study, name: str) -> CalibrationRecord | None:
    stored = stored_calibration(study, name)
    return None if stored is None else calibration_record(stored)


def _share(share: float | None) -> str:
    return MISSING if share is None else percent(share)
