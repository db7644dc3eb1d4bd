"""Validation: how estimate, screened and calibrated parameters do on a part that was not calibrated.

Its simulations are a few per calibration and decide nothing: the ledger does not count them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from studies.physical_model import open_physical_model
from studies.report.guideline14 import relative
from studies.report.validation import OutputFit, ValidatedPoint
from studies.stages.pipeline import Study
from studies.stages.stage_results import Validated


@dataclass(frozen=True)
class Validation:
    """Several parameter sets on the validation period.

    Attributes:
        points: The parameter sets by name, in the order they were given.
        time: Output times from the begin of the period on. Shape (t,). [s]
        y: Simulated outputs there by name, NaN where a simulation failed. Shape (t, k) each. [per output]
    """

    points: dict[str, ValidatedPoint]
    time: FloatArray
    y: dict[str, FloatArray]


def validate(case: Case, model: ForwardModel, points: Mapping[str, FloatArray]) -> Validation:
    """Simulate parameter sets over the validation period of a case and compare them.

    Args:
        case: The case, with a validation period.
        model: The model of the case `case.validation`.
        points: Parameter sets by name. Shape (p,) each. [per parameter]

    Returns:
        How they do.
    """
    assert case.validation is not None, "asked of a case that has one"
    measurement, window = case.validation.measurement, case.measurement
    answer = model.simulate(np.stack(list(points.values())))
    # A simulation that goes on after the window repeats the window first.
    n_window = len(window.time)
    has_window = np.array_equal(measurement.time[:n_window], window.time)
    mse = measurement.mse(answer.y)
    mse_window = window.mse(answer.y[:, :n_window]) if has_window else np.full(len(points), np.inf)
    shown = measurement.from_first_sample
    return Validation(
        points={
            name: ValidatedPoint(
                mse_window=float(mse_window[row]) if np.isfinite(mse_window[row]) else None,
                mse=float(mse[row]) if np.isfinite(mse[row]) else None,
                failure=answer.failures[row],
                outputs=_fits(case, measurement, answer.y[row]) if np.isfinite(mse[row]) else {},
            )
            for row, name in enumerate(points)
        },
        time=shown.time,
        y=dict(zip(points, answer.y[:, len(measurement.time) - len(shown.time) :], strict=True)),
    )


def _fits(case: Case, measurement: Measurement, y: FloatArray) -> dict[str, OutputFit]:
    fits = {}
    for k, output in enumerate(case.outputs):
        difference = measurement.differences(y[None], k)[0]
        rmse, bias = float(np.sqrt(np.mean(difference**2))), float(np.mean(difference))
        cv_rmse, nmbe = relative(rmse, bias, measurement, k, output.unit)
        fits[output.name] = OutputFit(len(difference), rmse, bias, cv_rmse, nmbe)
    return fits


class OfCalibration(TypedDict, total=False):
    """The fields of a `Calibration` that its validation fills."""

    validation: Validated
    validation_time: FloatArray
    validation_y: FloatArray
    validation_y_screened: FloatArray


def validate_calibration(study: Study, found: Mapping[str, FloatArray]) -> OfCalibration:
    """Validate a finished calibration of a study.

    Args:
        study: The study.
        found: What it found by name, the calibrated parameters last. Shape (p,) each. [per parameter]

    Returns:
        Fields of the calibration's result; none without a validation period.
    """
    case = study.case
    if case.validation is None:
        return {}
    with open_physical_model(study, case=case.validation) as model:
        validation = validate(case, model, {**_estimates(case), **found})
    fields: OfCalibration = {
        "validation": Validated(case.validation.window_d, validation.points),
        "validation_time": validation.time,
        "validation_y": validation.y[list(found)[-1]],
    }
    if "screened" in found:
        fields["validation_y_screened"] = validation.y["screened"]
    return fields


def validation_inputs(case: Case) -> dict[str, Any]:
    """Return what a calibration depends on beyond the case where it is validated; empty where it is not."""
    if case.validation is None:
        return {}
    inputs: dict[str, Any] = {"validation": [case.validation.digest, case.validation.measurement.digest]}
    if estimates := _estimates(case):
        inputs["estimates"] = estimates["estimate"].tolist()
    return inputs


def _estimates(case: Case) -> dict[str, FloatArray]:
    """Return the point of the estimates where every parameter has one, none otherwise."""
    known = [one.estimate for one in case.parameter_space.parameters if one.estimate is not None]
    is_whole = len(known) == case.parameter_space.n_parameters
    return {"estimate": np.array(known, dtype=np.float64)} if is_whole else {}
