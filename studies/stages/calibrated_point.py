"""What is said of a calibrated point without another simulation: fits of the outputs, open parameters.

`studies uncertainty` says how far open parameters may go.
"""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.measurement import Measurement
from simulation.store.stored_model import StoredModel
from studies.calibration.prior import Prior
from studies.report.output_fit import output_fit
from studies.stages.knowledge import prior_found, prior_of
from studies.stages.pipeline import Study
from studies.stages.stage_results import Calibration, Determined, Fit
from studies.uncertainty.identifiability import judged_slopes
from studies.uncertainty.noise import noise_of

CLEAR_PAIR = 0.9
"""A pair is named that makes up so much of an open direction's squared length."""


def calibration_at(
    study: Study,
    physical: StoredModel,
    *,
    y: FloatArray,
    theta: FloatArray,
    slopes: FloatArray | None,
    **more: Any,
) -> Calibration:
    """Return a calibration with all that follows from its point.

    Args:
        study: The study.
        physical: The model that was asked.
        y: The simulation at the point. Shape (t, k). [per output]
        theta: The point. Shape (p,). [per parameter]
        slopes: Of the residuals there, in an orthonormal basis. Shape (m, p). [first output's unit per range]
        more: The other fields of the calibration.
    """
    case, names, prior = study.case, study.case.parameter_space.names, prior_of(study.case)
    return Calibration(
        case=case.name,
        seed=study.profile.seed,
        theta=dict(zip(names, theta.tolist(), strict=True)),
        units={one.name: one.unit for one in case.parameter_space.parameters},
        output_unit=case.outputs[0].unit,
        error_name=case.measurement.error_name,
        outputs=fits(case, y),
        n_failed=len(physical.failures),
        first_failure=next(iter(physical.failures), None),
        n_simulated=physical.n_simulated,
        time=case.measurement.time,
        y=y,
        determined_by_data=determined(names, case.measurement, prior, y=y, slopes=slopes),
        prior=prior_found(case, theta),
        **more,
    )


def fits(case: Case, y: FloatArray) -> dict[str, Fit]:
    """Return how each output differs from its measurement, beside its sensor's uncertainty.

    Args:
        case: The case.
        y: A simulation. Shape (t, k). [per output]
    """
    found = {}
    for k, output in enumerate(case.outputs):
        difference = case.measurement.differences(y[None], k)[0]
        sensor = float(case.measurement.uncertainty[k])
        whole = output_fit(case.measurement, k, output.unit, y)
        fit = Fit(whole.rmse, nrmse=whole.nrmse, cv_rmse=whole.cv_rmse)
        if np.isfinite(sensor):
            share = float(np.mean(np.abs(difference) <= sensor))
            fit = replace(fit, uncertainty=sensor, share_within=share)
        if case.measurement.limits_of(k) is not None:
            excess = case.measurement.excess(y[None], k)[0]
            largest, share = float(excess[np.argmax(np.abs(excess))]), float(np.mean(excess != 0.0))
            fit = replace(fit, largest_excess=largest, share_beyond=share)
        found[output.name] = fit
    return found


def determined(
    names: tuple[str, ...],
    measurement: Measurement,
    prior: Prior | None,
    *,
    y: FloatArray,
    slopes: FloatArray | None,
) -> Determined | None:
    """Return which parameters the data leave open near a point; None where too little is known of slopes.

    Args:
        names: Names of the p free parameters.
        measurement: What they were calibrated with.
        prior: What is known of them beforehand, or None.
        y: The simulation at the point. Shape (t, k). [per output]
        slopes: Of the residuals there, in an orthonormal basis. Shape (m, p). [first output's unit per range]
    """
    # What fits to the last digit shows no noise to judge by.
    if slopes is None or not np.any(measurement.compared(y[None])):
        return None
    noise = noise_of("correlated", measurement, y, len(names))
    found = judged_slopes(names, slopes, noise.raised, prior=prior)
    # Two in two open directions, once with each sign, are both open, and none makes up for the other.
    n_times = Counter((pair.first, pair.second) for pair in found.pairs)
    return Determined(
        spread=dict(zip(names, found.spread.tolist(), strict=True)),
        open=tuple(name for name in names if name not in found.determined),
        pairs=tuple(
            one
            for one in found.pairs
            if n_times[one.first, one.second] == 1 and abs(one.strength) >= CLEAR_PAIR
        ),
    )
