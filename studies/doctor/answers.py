"""What the model's answers say: estimates, box, influence of every parameter and of every input."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.design import uniform_design
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.doctor.declared import temperature_doubt
from studies.doctor.finding import Finding
from studies.doctor.keeping import MORE_TIME, STOPPED
from studies.doctor.region import commonest, failing_region
from studies.report.wording import difference_unit, quantity, squared

N_CORNERS, N_COVERAGE = 32, 64
DOCTOR_SEED = 12_345
SAME = 1e-9
"""Two answers of one model to one question differ by no more than this. [output's unit]"""
UNSEEN_SHARE = 0.01
"""A parameter that moves the output by less than this share of the uncertainty cannot be identified."""
COVERED_SHARE = 0.9
"""Part of the measurement that should lie within the simulated envelope."""


_REMEDIES = {
    "accepted": "widen accepted of that output, or correct the estimates",
    STOPPED: MORE_TIME,
    "licen": "see that the licence can be reached from here; how many at once: [simulation] max_workers",
    "shared object": "install the system library that it names, or export the FMU with its libraries inside",
}
"""What to do, by a sign in the reason of a failure."""
_GENERAL_REMEDY = "try the FMU in another tool; correct the estimates, or have its exporter corrected"


@dataclass(frozen=True)
class Estimates:
    """The point that everything is compared with.

    Attributes:
        theta: The estimates, the middle of the bounds where there is none. Shape (p,). [per parameter]
        nominal: The model's answer there, one row.
    """

    theta: FloatArray
    nominal: Trajectories


def with_unit(unit: str) -> str:
    """Return a unit as it stands behind a number."""
    return "" if unit in ("", "1") else f" {unit}"


def look_at_estimates(case: Case, nominal: Trajectories) -> Iterator[Finding]:
    """Judge the answer to the estimates."""
    if nominal.failed[0]:
        yield Finding(
            "estimates", "fail", f"cannot be simulated: {nominal.failures[0]}", _remedy(nominal.failures[0])
        )
        return
    mse = float(case.measurement.mse(nominal.y)[0])
    spans = [(series.min(), series.max()) for series in nominal.y[0].T]
    ranges = ", ".join(
        f"{output.name} from {low:.4g} to {high:.4g}{with_unit(output.unit)}"
        for output, (low, high) in zip(case.outputs, spans, strict=True)
    )
    unit = squared(difference_unit(case.outputs[0].unit))
    yield Finding("estimates", "ok", f"MSE {quantity(mse, unit, 4)}, {ranges}")
    still = [output.name for k, output in enumerate(case.outputs) if np.ptp(nominal.y[0, :, k]) <= SAME]
    if still:
        yield Finding(
            "outputs move",
            "warn",
            f"constant over the window: {', '.join(still)}",
            "see whether the inputs reach the model and the output is the right one",
        )
    jumps = [
        output.name
        for k, output in enumerate(case.outputs)
        if _jumps(case.measurement.uncertainty[k], nominal.y[0, :, k])
    ]
    if jumps and not case.scenario.n_warmup:
        yield Finding(
            "first values",
            "warn",
            f"far from all that follow: {', '.join(jumps)}",
            "the FMU may compute them in its first step only; begin the window a step after start_d",
        )
    doubts = [
        f"{output.name}: {doubt}"
        for k, output in enumerate(case.outputs)
        if (doubt := temperature_doubt(nominal.y[0, :, k], output.unit))
    ]
    if doubts:
        yield Finding(
            "units of the outputs",
            "warn",
            "; ".join(doubts),
            "the FMU may not answer in the unit it declares; compare with the tool that made it",
        )


def _jumps(uncertainty: float, values: FloatArray) -> bool:
    """Say whether the first value is off by more than all others differ. Shape of values (t,)."""
    step = abs(float(values[0] - values[1]))
    return len(values) > 2 and step > max(10.0 * uncertainty, float(np.ptp(values[1:])))


def corner_points(case: Case, n: int) -> FloatArray:
    """Return at most n corners of the box, all lower and all upper bounds first. Shape (m, p)."""
    space = case.parameter_space
    sides = np.random.default_rng(DOCTOR_SEED).integers(0, 2, (4 * N_CORNERS, space.n_parameters))
    sides[0], sides[1] = 0, 1
    # Few parameters have few corners.
    _, first = np.unique(sides, axis=0, return_index=True)
    return space.from_unit(sides[np.sort(first)][:n].astype(np.float64))


def look_at_corners(space: ParameterSpace, answer: Trajectories) -> Finding:
    """Judge the answers at the corners of the box."""
    n_failed = int(answer.failed.sum())
    if not n_failed:
        return Finding("corners of the box", "ok", f"{answer.n} were simulated")
    return Finding(
        "corners of the box",
        "fail" if n_failed == answer.n else "warn",
        f"{n_failed} of {answer.n} corners failed{_where_and_why(space, answer)}",
        "narrow the bounds where the model breaks; failed rows are left out of training",
    )


def coverage_points(case: Case, n: int) -> FloatArray:
    """Return points all over the box. Shape (n, p)."""
    return uniform_design(case.parameter_space, N_COVERAGE, DOCTOR_SEED)[:n]


def look_at_coverage(case: Case, answer: Trajectories) -> Finding:
    """Say how much of the measurement the box can produce."""
    n_failed = int(answer.failed.sum())
    good = answer.y[~answer.failed]
    if len(good) < 2:
        return Finding(
            "box",
            "fail",
            f"{n_failed} of {answer.n} failed{_where_and_why(case.parameter_space, answer)}",
            "narrow the bounds where the model breaks",
        )
    n_inside = 0
    for k in range(len(case.outputs)):
        above = case.measurement.differences(good, k)
        n_inside += int(np.sum((above.min(axis=0) <= 0.0) & (above.max(axis=0) >= 0.0)))
    inside = n_inside / case.measurement.n_samples
    if n_failed > case.policy.max_failed_share * answer.n:
        return Finding(
            "box",
            "fail",
            f"{n_failed} of {answer.n} failed, so a campaign would be "
            f"stopped{_where_and_why(case.parameter_space, answer)}",
            "narrow the bounds where the model breaks; or allow more: [simulation] max_failed_share",
        )
    why = _where_and_why(case.parameter_space, answer) if n_failed else ""
    failed = f", {n_failed} of {answer.n} failed{why}" if n_failed else ""
    return Finding(
        "box covers the measurement",
        "ok" if inside >= COVERED_SHARE else "warn",
        f"{inside:.0%} of the measured values lie between {answer.n} simulations{failed}",
        "" if inside >= COVERED_SHARE else "widen the bounds, or check the unit of the measurement",
    )


def moved_points(case: Case, base: FloatArray) -> FloatArray:
    """Move each parameter to both of its bounds, one at a time. Shape (2 p, p)."""
    space = case.parameter_space
    p = space.n_parameters
    theta = np.tile(base, (2 * p, 1))
    theta[2 * np.arange(p), np.arange(p)] = space.lower
    theta[2 * np.arange(p) + 1, np.arange(p)] = space.upper
    return theta


def influence(case: Case, estimates: Estimates, answer: Trajectories) -> FloatArray:
    """Return how far each parameter moves an output.

    Args:
        case: the case.
        estimates: what the answers are compared with.
        answer: the answers to `moved_points`, or to the first of them.

    Returns:
        Largest change, NaN where both bounds failed. Shape (p,). [uncertainties]
    """
    p = answer.n // 2
    moved = np.abs(answer.y - estimates.nominal.y[0]).max(axis=1) / case.measurement.uncertainty
    return np.asarray(np.fmax.reduce(moved.max(axis=1).reshape(p, 2), axis=1))


def look_at_influence(case: Case, share: FloatArray, elsewhere: FloatArray | None) -> Finding:
    """Say whether every parameter moves an output.

    Args:
        case: the case.
        share: how far the first parameters move an output from the estimates, NaN where that is not known.
            Shape (p,). [uncertainties]
        elsewhere: the same from another point, where it was asked. Shape (p,). [uncertainties]
    """
    what, names = "every parameter moves an output", case.parameter_space.names[: len(share)]
    most = share if elsewhere is None else np.fmax(share, elsewhere)
    dead = [names[i] for i in np.flatnonzero(most <= SAME)]
    if dead:
        return Finding(
            what,
            "fail",
            f"no effect: {', '.join(dead)}",
            "name the variable that the equations use, or leave the parameter out",
        )
    still = [names[i] for i in np.flatnonzero(share <= SAME)]
    if still:
        return Finding(
            what,
            "warn",
            f"at the estimates {', '.join(still)} has no effect, elsewhere it has",
            "move the estimates to where the model does something, if they should matter",
        )
    unknown = [names[i] for i in np.flatnonzero(np.isnan(most))]
    if unknown:
        return Finding(
            what,
            "warn",
            f"not known of {', '.join(unknown)}: the simulations at both bounds fail",
            "narrow these bounds to where the model can be simulated",
        )
    weak = [names[i] for i in np.flatnonzero(most < UNSEEN_SHARE)]
    least = int(np.argmin(most))
    return Finding(
        what,
        "warn" if weak else "ok",
        f"the weakest, {names[least]}, by {most[least]:.2g} times the sensor's uncertainty",
        f"{', '.join(weak)} cannot be identified; leave out or fix" if weak else "",
    )


def look_at_inputs(names: tuple[str, ...], estimates: Estimates, answer: Trajectories) -> Finding:
    """Say whether every input moves an output.

    Args:
        names: inputs that were changed, one per row of the answer.
        estimates: what the answers are compared with.
        answer: answers to the estimates, each with one input changed.
    """
    what = "every input moves an output"
    moved = np.abs(answer.y - estimates.nominal.y[0]).max(axis=(1, 2))
    dead = [name for name, most in zip(names, moved, strict=True) if most <= SAME]
    if dead:
        return Finding(
            what,
            "warn",
            f"no effect: {', '.join(dead)}",
            "see whether the model uses this input, or is switched to use a table of its own",
        )
    failed = [f"{name}: {reason}" for name, reason in zip(names, answer.failures, strict=True) if reason]
    if failed:
        return Finding(what, "warn", f"fails with another value of {failed[0]}", "look at the input's values")
    return Finding(what, "ok", f"all {len(names)} do" if len(names) > 1 else f"{names[0]} does")


def _where_and_why(space: ParameterSpace, answer: Trajectories) -> str:
    """Say where rows failed, as far as one parameter explains it, and why most of them did."""
    region = failing_region(space, answer.theta, answer.failed)
    return f"{', ' if region else ''}{region}; the reason: {commonest(answer.failures)}"


def cannot_open(reason: str) -> Finding:
    """Say what to do about an FMU that cannot be opened: the reason may know it."""
    found, separator, own = reason.rpartition("; ")
    remedy = _remedy(reason)
    if remedy != _GENERAL_REMEDY or not separator:
        return Finding("opening the FMU", "fail", reason, remedy)
    return Finding("opening the FMU", "fail", found, own)


def _remedy(reason: str) -> str:
    for sign, remedy in _REMEDIES.items():
        if sign in reason.lower():
            return remedy
    return _GENERAL_REMEDY
