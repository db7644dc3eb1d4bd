"""A calibration of the most relevant parameters: what it fixed, what that cost, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from studies.report.records import CalibrationRecord, RestrictionRecord
from studies.report.wording import (
    count,
    declared,
    digits_between,
    listed,
    percent,
    quantity,
    shown_unit,
    significant,
)


def restriction_record(numbers: Mapping[str, Any]) -> RestrictionRecord | None:
    """Read a calibration's restriction, None for one of all parameters."""
    if "restriction" not in numbers:
        return None
    stored = numbers["restriction"]
    check = stored["check"] or {"gain": None, "gain_alone": {}, "n_calls": 0}
    return RestrictionRecord(
        n_free=stored["n_free"],
        fixed=tuple(stored["fixed"]),
        shares=stored["shares"],
        source=stored["source"],
        n_calls=stored["n_calls"],
        n_calls_before=stored["n_calls_before"],
        gain=check["gain"],
        gain_alone=check["gain_alone"],
        n_check=check["n_calls"],
    )


def unrestricted(
    calibration: CalibrationRecord, others: Iterable[CalibrationRecord]
) -> CalibrationRecord | None:
    """Return the calibration of all parameters by the same method, None where there is none."""
    wanted = calibration.method, calibration.n_train
    return next((c for c in others if c.restriction is None and (c.method, c.n_train) == wanted), None)


def restriction_sentences(
    calibration: CalibrationRecord, whole: CalibrationRecord | None, mse_unit: str
) -> tuple[str, ...]:
    """Say by what parameters were chosen, how clearly, and what fixing the others cost.

    Args:
        calibration: The calibration; of one of all parameters there is nothing to say.
        whole: That of all parameters by the same method, None where there is none.
        mse_unit: Unit of an MSE.
    """
    r = calibration.restriction
    if r is None:
        return ()
    return _relevance_sentence(r), _cost_sentence(calibration, r, whole, mse_unit)


def _relevance_sentence(r: RestrictionRecord) -> str:
    cost = (
        f"counted: {count(r.n_calls, 'call')} for Morris' elementary effects"
        if r.source == "Morris"
        else f"not counted: the stored Sobol indices had cost {count(r.n_calls_before, 'call')}"
    )
    sentence = f"Relevance by {r.source}, {cost}"
    if r.closest_call is None:
        return f"{sentence}."
    free, fixed = ((name, 100.0 * (r.shares[name] or 0.0)) for name in r.closest_call)
    digits = digits_between(free[1], fixed[1], least=2)
    calibrated, left = (f"{name}, {significant(share, digits)} %" for name, share in (free, fixed))
    return f"{sentence}. Least relevant calibrated: {calibrated}; most relevant fixed: {left}."


def _cost_sentence(
    calibration: CalibrationRecord, r: RestrictionRecord, whole: CalibrationRecord | None, mse_unit: str
) -> str:
    parts = []
    if whole is not None and 0.0 < whole.mse_polished < math.inf:
        parts.append(
            f"the MSE is {calibration.mse_polished / whole.mse_polished:.3g} times the "
            f"{quantity(whole.mse_polished, mse_unit)} of the stored calibration of all parameters "
            f"({count(whole.calls_paper, 'call')})"
        )
    if r.gain is not None:
        parts.append(
            f"freed, they would gain {percent(r.gain)} of the error within a tenth of their ranges, "
            f"by differences at the optimum ({count(r.n_check, 'call')}, counted)"
        )
    elif r.n_check:
        parts.append("what freeing them would gain is not known, the optimum failed when simulated again")
    return f"What the fixing cost: {'; '.join(parts) or 'not known, the budget held no check of it'}."


def condition_sentence(fixed: Mapping[str, float], why: Mapping[str, str], units: Mapping[str, str]) -> str:
    """Say on what values of fixed parameters all rests that is known of the free ones.

    Args:
        fixed: The values by name. [per parameter]
        why: Where each comes from, in words.
        units: Unit of each parameter.
    """
    values = [
        f"{name} = {declared(value)} {shown_unit(units[name])}".rstrip() + f" ({why[name]})"
        for name, value in fixed.items()
    ]
    return (
        f"All this holds only if what was fixed is right: {listed(values)}. What is not known about "
        f"{'it' if len(values) == 1 else 'these'} is in no interval, sample or band here."
    )
