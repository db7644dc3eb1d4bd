"""Validation: how estimate, screened and calibrated parameters do on a part that was not calibrated.

Its simulations are a few per calibration and decide nothing: the ledger does not count them.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories
from studies.physical_model import open_physical_model
from studies.report.output_fit import output_fit
from studies.stages.pipeline import Study
from studies.stages.stage_results import Calibration, Validated, ValidatedPoint


def validate(
    case: Case, model: ForwardModel, points: Mapping[str, FloatArray]
) -> tuple[Validated, Trajectories]:
    """Simulate parameter sets over the validation period of a case and compare them.

    Args:
        case: The case, with a validation period.
        model: The model of the case `case.validation`.
        points: Parameter sets by name. Shape (p,) each. [per parameter]

    Returns:
        How they do, and their simulations, from before the period on.
    """
    assert case.validation is not None, "asked of a case that has one"
    measurement, window = case.validation.measurement, case.measurement
    answer = model.simulate(np.stack(list(points.values())))
    # A simulation that goes on after the window repeats the window first.
    n_window = len(window.time)
    is_later = not case.validation.experiments
    has_window = is_later and np.array_equal(measurement.time[:n_window], window.time)
    mse = measurement.mse(answer.y)
    mse_window = window.mse(answer.y[:, :n_window]) if has_window else np.full(len(points), np.inf)
    found = {
        name: ValidatedPoint(
            mse_window=float(mse_window[row]) if np.isfinite(mse_window[row]) else None,
            mse=float(mse[row]) if np.isfinite(mse[row]) else None,
            failure=answer.failures[row],
            outputs={
                output.name: output_fit(measurement, k, output.unit, answer.y[row])
                for k, output in enumerate(case.validation.outputs)
                if np.isfinite(mse[row])
            },
        )
        for row, name in enumerate(points)
    }
    return Validated(case.validation.window_d, found), answer


def with_validation(study: Study, found: Calibration, points: Mapping[str, FloatArray]) -> Calibration:
    """Return a calibration with how it does on the validation period, unchanged where the case has none.

    Args:
        study: The study.
        found: The calibration.
        points: What it found by name, the calibrated parameters last. Shape (p,) each. [per parameter]
    """
    case = study.case
    if case.validation is None:
        return found
    points = {**_estimates(case), **points}
    with open_physical_model(study, case=case.validation) as model:
        validated, answer = validate(case, model, points)
    time = case.validation.measurement.from_first_sample.time
    y = dict(zip(points, answer.y[:, -len(time) :], strict=True))
    return replace(
        found,
        validation=validated,
        validation_time=time,
        validation_y=y[list(points)[-1]],
        validation_y_screened=y.get("screened"),
    )


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
