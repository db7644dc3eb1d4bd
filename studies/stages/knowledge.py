"""What a case says beforehand of its parameters: inputs of the stages, and how far a result moved from it."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from simulation.arrays import FloatArray
from simulation.case import Case
from studies.calibration.prior import Prior
from studies.results.stage_results import Held, PriorFound


def prior_of(case: Case) -> Prior | None:
    """Return what the case says is known about its parameters, None where it says nothing.

    Raises:
        InputError: If it cannot be weighed against the measurement.
    """
    return Prior.of(case.parameter_space, case.measurement)


def case_inputs(case: Case) -> dict[str, Any]:
    """Return what every calibration depends on: case, measurement, scales, and priors where it has any."""
    space, prior = case.parameter_space, prior_of(case)
    inputs = {"case": case.digest, "measurement": case.measurement.digest, "is_log": space.is_log.tolist()}
    if prior is not None:
        beliefs = {one.name: asdict(one.prior) for one in space.parameters if one.prior is not None}
        inputs["prior"] = {"parameters": beliefs, "weight": prior.weight}
    return inputs


def is_current(inputs: Mapping[str, Any], case: Case) -> bool:
    """Say whether a stage had the case, measurement, scales and priors that are declared now.

    Args:
        inputs: The stage's inputs, as its manifest has them.
        case: The case.
    """
    present = case_inputs(case)
    return all(inputs.get(name) == present.get(name) for name in ("case", "measurement", "is_log", "prior"))


def sensor_inputs(case: Case) -> dict[str, Any]:
    """Return what sensors' noise depends on beyond the measurement; empty where nothing is declared."""
    lasts_s = [one.error_lasts_s for one in case.outputs]
    return {"error_lasts_s": lasts_s} if any(lasts_s) else {}


def declared_inputs(case: Case) -> dict[str, Any]:
    """Return what a case declares that neither its digest nor its measurement's holds."""
    parameters = case.parameter_space.parameters
    return {
        "is_log": case.parameter_space.is_log.tolist(),
        "estimates": [parameter.estimate for parameter in parameters],
        "beliefs": [None if parameter.prior is None else asdict(parameter.prior) for parameter in parameters],
        "error_lasts_s": [one.error_lasts_s for one in case.outputs],
    }


def prior_found(case: Case, theta: FloatArray) -> PriorFound | None:
    """Return how far a calibrated point lies from what was known; None where nothing was.

    Args:
        case: The case.
        theta: The point. Shape (p,). [per parameter]
    """
    prior = prior_of(case)
    if prior is None:
        return None
    space = case.parameter_space
    u = space.to_unit(theta)
    held = {}
    for one, moved in zip(space.parameters, prior.deviations(u).tolist(), strict=True):
        if one.prior is not None:
            how = "within_factor" if one.scale == "log" else "within"
            held[one.name] = Held(one.prior.centre, moved, **{how: one.prior.deviation})
    return PriorFound(prior.weight, prior.n_independent, float(prior.penalty(u[None])[0]), held)
