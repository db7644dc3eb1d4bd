"""What is known about parameters beforehand, as stages have it: in inputs, numbers and on the terminal."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from simulation.arrays import FloatArray
from simulation.case import Case
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


def case_inputs(case: Case) -> dict[str, Any]:
    """Return what every calibration depends on: case, measurement, scales, and priors where it has any."""
    digests = {"case": case.digest, "measurement": case.measurement.digest}
    return {**digests, "is_log": case.parameter_space.is_log.tolist(), **_prior_inputs(case)}


def _prior_inputs(case: Case) -> dict[str, Any]:
    prior = prior_of(case)
    if prior is None:
        return {}
    parameters = case.parameter_space.parameters
    beliefs = {one.name: asdict(one.prior) for one in parameters if one.prior is not None}
    return {"prior": {"parameters": beliefs, "weight": prior.weight}}


def is_of_this_density(inputs: Mapping[str, Any], case: Case) -> bool:
    """Say whether a stage had the scales and priors that the case declares now.

    Args:
        inputs: The stage's inputs, as its manifest has them.
        case: The case.
    """
    present = case_inputs(case)
    return all(inputs.get(name) == present.get(name) for name in ("is_log", "prior"))


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
    prior, units = found["prior"], {one.name: one.unit for one in study.case.parameter_space.parameters}
    rows = [
        [
            name,
            units[name],
            belief_text(one),
            f"{found['theta'][name]:.6g}",
            f"{one['moved_deviations']:+.2f}",
            "the data contradict it" if abs(one["moved_deviations"]) > FAR else "",
        ]
        for name, one in prior["parameters"].items()
    ]
    columns = [Column("parameter"), Column("unit"), Column("known before", True), Column("calibrated", True)]
    columns += [Column("moved by [standard deviations]", True), Column("")]
    unit = squared(difference_unit(study.case.outputs[0].unit))
    study.console.table(f"{study.label}: parameters held by a prior ({how})", columns, rows)
    study.console.result(
        f"One standard deviation weighs as much as {quantity(prior['weight'], unit)} of MSE "
        f"({prior['n_independent']:.4g} independent samples); all priors together "
        f"{quantity(prior['penalty'], unit)}, which no MSE shown here includes"
    )


def known_before(numbers: Mapping[str, Any]) -> tuple[str, ...]:
    """Say what was known of each parameter, "" for nothing; empty where of none."""
    held = numbers.get("prior", {}).get("parameters")
    if not held:
        return ()
    return tuple(
        f"prior {belief_text(held[name])}, moved by {held[name]['moved_deviations']:+.2f} of it"
        if name in held
        else ""
        for name in numbers["theta"]
    )


def belief_text(one: Mapping[str, float]) -> str:
    """Say what is known of a parameter, e.g. `0.7 ×/÷ 1.5` or `290 ± 2`."""
    if "within_factor" in one:
        return f"{one['about']:.4g} ×/÷ {one['within_factor']:.4g}"
    return f"{one['about']:.4g} ± {one['within']:.4g}"
