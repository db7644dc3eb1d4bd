"""What is known about parameters beforehand, as stages have it: in inputs, numbers and on the terminal."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.parameters import ParameterSpace
from studies.calibration.prior import Prior
from studies.console import Column
from studies.report.wording import difference_unit, quantity, squared
from studies.stages.pipeline import Study

FAR = 2.0
"""So many standard deviations from what was known, the data contradict it."""


def prior_of(case: Case) -> Prior | None:
    """Return what the case says is known about its parameters, None where it says nothing.

    Raises:
        InputError: If it cannot be weighed against the measurement.
    """
    return Prior.of(case.parameter_space, case.measurement)


def prior_inputs(case: Case, space: ParameterSpace | None = None) -> dict[str, Any]:
    """Return what a stage depends on beyond the case where it declares priors; empty where not.

    Args:
        case: The case.
        space: The parameters that the stage is about; None for all.
    """
    space = case.parameter_space if space is None else space
    prior = Prior.of(space, case.measurement)
    if prior is None:
        return {}
    beliefs = {one.name: asdict(one.prior) for one in space.parameters if one.prior is not None}
    return {"prior": {"parameters": beliefs, "weight": prior.weight}}


def is_of_this_density(inputs: Mapping[str, Any], case: Case, space: ParameterSpace | None = None) -> bool:
    """Say whether a stage had the scales and priors that the case declares now.

    Args:
        inputs: The stage's inputs, as its manifest has them.
        case: The case.
        space: The parameters that the stage was about; None for all.
    """
    space, present = case.parameter_space if space is None else space, prior_inputs(case, space)
    is_log = space.is_log.tolist()
    return inputs.get("is_log", is_log) == is_log and inputs.get("prior") == present.get("prior")


def sensor_inputs(case: Case) -> dict[str, Any]:
    """Return what sensors' noise depends on beyond the measurement; empty where nothing is declared."""
    lasts_s = case.measurement.error_lasts_s
    return {"error_lasts_s": lasts_s.tolist()} if lasts_s.any() else {}


def declared_inputs(case: Case) -> dict[str, Any]:
    """Return what a case declares that neither its digest nor its measurement's holds."""
    parameters = case.parameter_space.parameters
    return {
        "is_log": case.parameter_space.is_log.tolist(),
        "estimates": [parameter.estimate for parameter in parameters],
        "beliefs": [None if parameter.prior is None else asdict(parameter.prior) for parameter in parameters],
        "error_lasts_s": case.measurement.error_lasts_s.tolist(),
    }


def prior_numbers(case: Case, theta: FloatArray) -> dict[str, Any]:
    """Return how far a calibrated point lies from what was known; empty where nothing was.

    Args:
        case: The case.
        theta: The point. Shape (p,). [per parameter]
    """
    prior = prior_of(case)
    if prior is None:
        return {}
    space = case.parameter_space
    u = space.to_unit(theta)
    moved = prior.deviations(u)
    return {
        "prior": {
            "weight": prior.weight,
            "n_independent": prior.n_independent,
            "penalty": float(prior.penalty(u[None])[0]),
            "parameters": {
                one.name: {
                    "about": one.prior.centre,
                    ("within_factor" if one.scale == "log" else "within"): one.prior.deviation,
                    "moved_deviations": float(moved[j]),
                }
                for j, one in enumerate(space.parameters)
                if one.prior is not None
            },
        }
    }


def show_prior(study: Study, found: Mapping[str, Any], how: str) -> None:
    """Print how far the result moved from what was known; nothing where nothing was.

    Args:
        study: the study.
        found: a calibration's numbers.
        how: how it was found, in a word.
    """
    if "prior" not in found:
        return
    told, fixed = found["prior"], found.get("restriction", {}).get("fixed", {})
    space = study.case.parameter_space
    rows = []
    for parameter in space.parameters:
        if parameter.name not in told["parameters"]:
            continue
        one = told["parameters"][parameter.name]
        moved = one["moved_deviations"]
        rows.append(
            [
                parameter.name,
                parameter.unit,
                told_belief(one),
                f"{found['theta'][parameter.name]:.6g}",
                f"{moved:+.2f}",
                "fixed" if parameter.name in fixed else "the data contradict it" if abs(moved) > FAR else "",
            ]
        )
    columns = [Column("parameter"), Column("unit"), Column("known before", True), Column("calibrated", True)]
    columns += [Column("moved by [standard deviations]", True), Column("")]
    unit = squared(difference_unit(study.case.outputs[0].unit))
    study.console.table(f"{study.label}: parameters held by a prior ({how})", columns, rows)
    study.console.result(
        f"One standard deviation weighs as much as {quantity(told['weight'], unit)} of MSE "
        f"({told['n_independent']:.4g} independent samples); all priors together "
        f"{quantity(told['penalty'], unit)}, which no MSE told here includes"
    )


def known_before(numbers: Mapping[str, Any]) -> tuple[str, ...]:
    """Say what was known of each parameter or decided about it, "" for nothing; empty where of none."""
    held = numbers.get("prior", {}).get("parameters", {})
    fixed = numbers.get("restriction", {}).get("fixed", {})
    if not held and not fixed:
        return ()
    return tuple(
        f"fixed at {numbers['restriction']['why'][name]}"
        if name in fixed
        else f"prior {told_belief(held[name])}, moved by {held[name]['moved_deviations']:+.2f} of it"
        if name in held
        else ""
        for name in numbers["theta"]
    )


def told_belief(one: Mapping[str, float]) -> str:
    """Say what is known of a parameter, e.g. `0.7 ×/÷ 1.5` or `290 ± 2`."""
    if "within_factor" in one:
        return f"{one['about']:.4g} ×/÷ {one['within_factor']:.4g}"
    return f"{one['about']:.4g} ± {one['within']:.4g}"
