"""What the terminal says of a calibration of the most relevant parameters."""

from collections.abc import Mapping
from typing import Any

from studies.console import Column
from studies.paths import size_name
from studies.report.restriction_told import restriction_sentences, unrestricted
from studies.report.wording import MISSING, difference_unit, percent, squared
from studies.stages.pipeline import Study
from studies.stages.results import ADAPTIVE, calibration_record, restricted, stored_calibrations


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
    records = {one.name: calibration_record(one) for one in stored_calibrations(study)}
    method = ADAPTIVE if found.get("method") == ADAPTIVE else size_name(found["n_train"])
    record = records[method + restricted(told["n_free"])]
    unit = squared(difference_unit(study.case.outputs[0].unit))
    for sentence in restriction_sentences(record, unrestricted(record, records.values()), unit):
        console.result(sentence)


def _share(share: float | None) -> str:
    return MISSING if share is None else percent(share)
