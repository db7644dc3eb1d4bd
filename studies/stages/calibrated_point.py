"""What is said of a calibrated point: fits of the outputs, open parameters, validation.

The simulations of that period are a few per calibration and decide nothing: the ledger does not count them.
`studies uncertainty` says how far open parameters may go.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories
from studies.calibration.largest_samples import FAR
from studies.calibration.ledger import Ledger
from studies.calibration.polish import PolishResult
from studies.calibration.prior import Prior
from studies.calibration.recorder import History
from studies.calibration.search.adaptive import AdaptiveResult
from studies.calibration.uncertainty.identifiability import judged_slopes
from studies.calibration.uncertainty.noise import noise_of
from studies.physical_model import open_physical_model
from studies.results.stage_results import (
    Calibration,
    Determined,
    Fit,
    LargestSample,
    OutputFit,
    Validated,
    ValidatedPoint,
)
from studies.stages.knowledge import prior_found, prior_of
from studies.task import Task
from studies.words.wording import difference_unit, moment_of

QUICK_S, ENOUGH_CALLS = 1.0, 10
"""The best simulation is repeated where it is quick, or one of so many that one more costs little."""


def calibration_at(
    task: Task,
    physical: StoredModel,
    found: AdaptiveResult | PolishResult,
    *,
    repeated: "Repeated",
    ledger: Ledger,
    history: History,
    **more: Any,
) -> Calibration:
    """Return a calibration with all that follows from its point, the validation as well.

    Args:
        task: The study.
        physical: The model that was asked.
        found: The point.
        repeated: How the best simulation was repeated.
        ledger: Model calls by purpose.
        history: Best error over model calls.
        more: The other fields of the calibration.
    """
    case, names, prior, y = task.case, task.case.parameter_space.names, prior_of(task.case), found.y
    calibration = Calibration(
        case=case.name,
        seed=task.profile.seed,
        theta=case.parameter_space.named(found.theta),
        units={one.name: one.unit for one in case.parameter_space.parameters},
        output_unit=case.outputs[0].unit,
        error_name=case.measurement.error_name,
        mse=found.mse,
        stop_reason=found.stop_reason,
        converged=found.converged,
        outputs=fits(case, y),
        ledger=ledger.to_dict(),
        n_failed=len(physical.failures),
        first_failure=next(iter(physical.failures), None),
        n_simulated=physical.n_simulated,
        time=case.measurement.time,
        y=y,
        history_calls=history.n_calls,
        history_mse=history.best_mse,
        determined_by_data=determined(names, case.measurement, prior, y=y, slopes=found.slopes),
        prior=prior_found(case, found.theta),
        n_repeated=repeated.n_simulations,
        is_random=repeated.is_random,
        has_own_processes=repeated.has_own_processes,
        **more,
    )
    return calibration if case.validation is None else _with_validation(task, calibration, case.validation)


@dataclass(frozen=True)
class Repeated:
    """What came of simulations that were repeated, see `repeat_best`.

    Attributes:
        n_simulations: How many.
        is_random: Whether the best one was another one in a new process.
        has_own_processes: Whether each simulation has a process of its own because the FMU does not forget
            one before the next.
    """

    n_simulations: int
    is_random: bool
    has_own_processes: bool


def repeat_best(physical: StoredModel, theta: FloatArray, n_calls: int) -> Repeated:
    """Repeat the best simulation in a new process, unless that is dear, before it is shown.

    Args:
        physical: The model that was asked.
        theta: The best parameters. Shape (p,). [per parameter]
        n_calls: What was asked of it before.

    Raises:
        ReuseError: If the simulation depended on those before it in its process.
    """
    is_dear = (physical.simulation_s or 0.0) > QUICK_S and n_calls < ENOUGH_CALLS
    is_stored = bool(physical.store.find_good(theta[None])[0])
    is_random = is_stored and not is_dear and not physical.repeats(theta)
    return Repeated(physical.reuse.n_repeated, is_random, physical.store.is_reuse_given_up)


def fits(case: Case, y: FloatArray) -> dict[str, Fit]:
    """Return how each output differs from its measurement, beside its sensor's uncertainty.

    Args:
        case: The case.
        y: A simulation. Shape (t, k). [per output]
    """
    found = {}
    for k, output in enumerate(case.outputs):
        difference = case.measurement.differences(y[None], k)[0]
        sensor = output.uncertainty
        whole = output_fit(case.measurement, k, output.unit, y)
        more = dict[str, Any](largest=_largest(case, k, difference))
        if np.isfinite(sensor):
            own = output.samples.deviations
            share = float(np.mean(np.abs(difference) <= (sensor if own is None else own)))
            more |= {"uncertainty": sensor, "share_within": share, "of_each_sample": own is not None}
        if output.limits is not None:
            excess = case.measurement.excess(y[None], k)[0]
            more["largest_excess"] = float(excess[np.argmax(np.abs(excess))])
            more["share_beyond"] = float(np.mean(excess != 0.0))
        found[output.name] = Fit(whole.rmse, nrmse=whole.nrmse, cv_rmse=whole.cv_rmse, **more)
    return found


def _largest(case: Case, k: int, difference: FloatArray) -> LargestSample | None:
    """Return the sample of an output that stands alone among its differences (m,), None for none."""
    output, sizes = case.outputs[k], np.abs(difference)
    worst, median = int(np.argmax(sizes)), float(np.median(sizes))
    # What the sensor cannot show is no wrong sample, however exact all others are.
    if not (output.is_measured and sizes[worst] > max(FAR * median, output.uncertainty)):
        return None
    return LargestSample(
        difference=float(difference[worst]),
        at=moment_of(case, output, worst),
        times_median=float(sizes[worst]) / median if median else None,
    )


def determined(
    names: tuple[str, ...],
    measurement: Measurement,
    prior: Prior | None,
    *,
    y: FloatArray,
    slopes: FloatArray | None,
) -> Determined | None:
    """Return which parameters the data leave open near a point; None where too little is known of slopes.

    The noise is that of `noise_of`, as `studies uncertainty` takes it unless another is asked for.

    Args:
        names: Names of the p free parameters.
        measurement: What they were calibrated with.
        prior: What is known of them beforehand, or None.
        y: The simulation at the point. Shape (t, k). [per output]
        slopes: Of the residuals there, in an orthonormal basis. Shape (m, p). [first output's unit per range]
    """
    if slopes is None:
        return None
    noise = noise_of("correlated", measurement, y, len(names))
    found = judged_slopes(names, slopes, noise.raised, prior=prior)
    return Determined(
        spread=dict(zip(names, found.spread.tolist(), strict=True)),
        open=tuple(name for name in names if name not in found.determined),
        pairs=found.pairs,
        ridges=found.ridges,
    )


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


def _with_validation(task: Task, found: Calibration, period: Case) -> Calibration:
    """Return a calibration with how it does on the validation period."""
    # Within a budget the calibrated point alone.
    points = {} if task.profile.is_budgeted else _estimates(task.case)
    if found.screening is not None and not task.profile.is_budgeted:
        points["screened"] = np.array(list(found.screening.theta.values()))
    points[found.final] = found.point
    with open_physical_model(task, case=period) as model:
        validated, answer = validate(task.case, model, points)
    time = period.measurement.from_first_sample.time
    y = dict(zip(points, answer.y[:, -len(time) :], strict=True))
    return replace(
        found,
        validation=validated,
        validation_time=time,
        validation_y=y[found.final],
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


def output_fit(measurement: Measurement, output: int, unit: str, y: FloatArray) -> OutputFit:
    """Return how one output of a trajectory differs from its measurement.

    CV(RMSE) is the root mean square difference over the size of the mean measured value, NMBE the mean
    difference over it. Both sums are divided by n - 1, as in ASHRAE guideline 14 (2014). NRMSE is the root
    mean square difference over the range of the measured values.

    Args:
        measurement: What was measured.
        output: Position of the output.
        unit: Unit of the output.
        y: The trajectory, finite. Shape (t, k). [units]
    """
    difference = measurement.differences(y[None], output)[0]
    rmse, bias = float(np.sqrt(np.mean(difference**2))), float(np.mean(difference))
    values = measurement.outputs[output].samples.values
    if not measurement.outputs[output].is_measured:
        return OutputFit(len(values), rmse, bias, None, None)
    span = float(np.ptp(values))
    nrmse = rmse / span if span > 0.0 else None
    # Of what is negative where it is taken out, as cooling is, the size counts.
    n, mean = len(values), abs(float(np.mean(values)))
    is_temperature = difference_unit(unit) == "K" or unit == "degF"
    if is_temperature or mean == 0.0 or n == 1:
        return OutputFit(n, rmse, bias, None, None, nrmse)
    return OutputFit(n, rmse, bias, rmse / mean * math.sqrt(n / (n - 1)), bias / mean * n / (n - 1), nrmse)
