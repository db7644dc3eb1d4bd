"""Validation: how estimate, screened and calibrated parameters do on a part that was not calibrated.

Its simulations are a few per calibration and decide nothing: the ledger does not count them.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from simulation.time_unit import period_text
from studies.console import Column
from studies.physical_model import open_physical_model
from studies.report.guideline14 import relative
from studies.report.validation import OutputFit, ValidatedPoint
from studies.report.wording import difference_unit, quantity, significant, squared
from studies.stages.pipeline import Outcome, Study


@dataclass(frozen=True)
class Validation:
    """Several parameter sets on the validation period.

    Attributes:
        period_d: The period. [d]
        points: The parameter sets by name, in the order they were given.
        time: Output times from the begin of the period on. Shape (t,). [s]
        y: Simulated outputs there, NaN where a simulation failed. Shape (n, t, k). [per output]
    """

    period_d: tuple[float, float]
    points: dict[str, ValidatedPoint]
    time: FloatArray
    y: FloatArray

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the trajectories as plain values."""
        return {
            "period_d": list(self.period_d),
            "n_simulations": len(self.points),
            "points": {name: asdict(point) for name, point in self.points.items()},
        }


def validate(case: Case, model: ForwardModel, points: Mapping[str, FloatArray]) -> Validation:
    """Simulate parameter sets over the validation period of a case and compare them.

    Args:
        case: The case, with a validation period.
        model: The model of the case `case.validation`.
        points: Parameter sets by name. Shape (p,) each. [per parameter]

    Returns:
        How they do.

    Raises:
        ValueError: If the case has no validation period.
    """
    if case.validation is None:
        raise ValueError(f"{case.path} has no validation period")
    measurement = case.validation.measurement
    answer = model.simulate(np.stack(list(points.values())))
    # A simulation that goes on after the window repeats the window first.
    n_window = len(case.measurement.time)
    has_window = np.array_equal(measurement.time[:n_window], case.measurement.time)
    mse = measurement.mse(answer.y)
    mse_window = case.measurement.mse(answer.y[:, :n_window]) if has_window else np.full(len(points), np.inf)
    shown = measurement.from_first_sample
    return Validation(
        period_d=case.validation.window_d,
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
        y=answer.y[:, len(measurement.time) - len(shown.time) :],
    )


def _fits(case: Case, measurement: Measurement, y: FloatArray) -> dict[str, OutputFit]:
    fits = {}
    for k, output in enumerate(case.outputs):
        difference = measurement.differences(y[None], k)[0]
        rmse, bias = float(np.sqrt(np.mean(difference**2))), float(np.mean(difference))
        cv_rmse, nmbe = relative(rmse, bias, measurement, k, output.unit)
        fits[output.name] = OutputFit(
            n_samples=len(difference),
            rmse=rmse,
            bias=bias,
            cv_rmse=cv_rmse,
            nmbe=nmbe,
        )
    return fits


def validate_calibration(
    study: Study, found: Mapping[str, FloatArray]
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Validate a finished calibration of a study.

    Args:
        study: The study.
        found: What it found by name, the calibrated parameters last. Shape (p,) each. [per parameter]

    Returns:
        Numbers and arrays to be kept with the calibration; both empty without a validation period.
    """
    case = study.case
    if case.validation is None:
        return {}, {}
    points = dict(found)
    estimates = _estimates(case)
    if estimates:
        points = {"estimate": np.array(estimates, dtype=np.float64), **points}
    with open_physical_model(study, case=case.validation) as model:
        validation = validate(case, model, points)
    simulated = dict(zip(points, validation.y, strict=True))
    arrays = {f"validation_y_{name}": simulated[name] for name in found}
    return {"validation": validation.to_dict()}, {"validation_time": validation.time, **arrays}


def validation_inputs(case: Case) -> dict[str, Any]:
    """Return what a calibration depends on beyond the case where it is validated; empty where it is not."""
    if case.validation is None:
        return {}
    digests = [case.validation.digest, case.validation.measurement.digest]
    estimates = _estimates(case)
    return {"validation": digests} | ({"estimates": estimates} if estimates else {})


def _estimates(case: Case) -> list[float]:
    """Return the estimates where every parameter has one, empty otherwise."""
    known = [one.estimate for one in case.parameter_space.parameters if one.estimate is not None]
    return known if len(known) == case.parameter_space.n_parameters else []


def show_validation(study: Study, outcomes: list[Outcome]) -> None:
    """Print one row per training-set size and parameter set; nothing without a validation period."""
    validation = study.case.validation
    if validation is None:
        return
    unit = squared(difference_unit(study.case.outputs[0].unit))
    units = {output.name: output.unit for output in study.case.outputs}
    columns = [Column("n_train", True), Column("parameters"), Column("MSE window", True)]
    columns += [Column("MSE validation", True), Column("RMSE by output", True)]
    rows = []
    for outcome in outcomes:
        for name, point in outcome.summary["validation"]["points"].items():
            fits = [
                f"{output} {quantity(point['outputs'][output]['rmse'], difference_unit(unit_k))}"
                for output, unit_k in units.items()
                if output in point["outputs"]
            ]
            errors = [point["mse_window"], point["mse"]]
            rows.append(
                [
                    outcome.summary["n_train"] or "–",
                    name,
                    *("–" if error is None else significant(error, 4) for error in errors),
                    ", ".join(fits) or f"failed: {point['failure']}",
                ]
            )
    study.console.table(
        f"{study.label}: validation on {period_text(validation.window_d)} (MSE in {unit}; its simulations "
        "are in no count of calls)",
        columns,
        rows,
    )
