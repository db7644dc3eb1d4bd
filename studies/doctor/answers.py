"""What the model's answers say: estimates, box, influences, and the same again in other circumstances."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.design import uniform_design
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.forward_model import ForwardModel
from simulation.pool.execution import commonest
from simulation.trajectories import Trajectories
from studies.circumstances import CircumstanceModel
from studies.doctor.declared import unit_problem
from studies.doctor.finding import MORE_TIME, STOPPED, Finding, Level, finding, named
from studies.report.figures_model import enclosed_fraction
from studies.report.wording import percent, quantity, shown_unit, square_of

N_CORNERS, N_COVERAGE = 32, 64
DOCTOR_SEED = 12_345
N_HALVINGS = 5
"""Rows that find out from where on a bound fails: to 1/32 of the way to it."""
SAME = 1e-9
"""Two answers of one model to one question differ by no more than this. [output's unit]"""
UNSEEN_SHARE = 0.01
"""A parameter that moves the output by less than this share of the uncertainty cannot be identified."""
COVERED_SHARE = 0.9
"""Part of the measurement that should lie within the simulated envelope."""
STEP_SHARE = 0.2
"""Halving the communication step may change the output by this share of the sensor's uncertainty."""
INPUT_SHARE = 0.1
"""A constant input is changed by this share of its size."""
EVEN = 1e-3
"""An input that differs by this share of its range from its reverse is the same in reverse."""
_REMEDIES = {
    "accepted": "widen accepted of that output, or correct the estimates",
    STOPPED: MORE_TIME,
    "licen": "see that the licence can be reached from here; how many at once: [simulation] max_workers",
    "shared object": "install the system library that it names, or export the FMU with its libraries inside",
}
"""What to do, by a sign in the reason of a failure."""
_GENERAL_REMEDY = "try the FMU in another tool; correct the estimates, or have its exporter corrected"


def with_unit(unit: str) -> str:
    """Return a unit as it stands behind a number."""
    return "" if unit in ("", "1") else f" {unit}"


def cannot_open(reason: str) -> Finding:
    """Say what to do about an FMU that cannot be opened: the reason may know it."""
    found, separator, own = reason.rpartition("; ")
    remedy = _remedy(reason)
    if remedy == _GENERAL_REMEDY and separator:
        reason, remedy = found, own
    return finding("cannot-open", "fail", reason=reason, remedy=remedy)


def look_at_estimates(case: Case, nominal: Trajectories) -> Iterator[Finding]:
    """Judge the answer to the estimates."""
    if reason := nominal.failures[0]:
        yield finding("estimates-fail", "fail", reason=reason, remedy=_remedy(reason))
        return
    mse = float(case.measurement.mse(nominal.y)[0])
    series = list(zip(case.outputs, nominal.y[0].T, strict=True))
    ranges = [f"{one.name} from {y.min():.4g} to {y.max():.4g}{with_unit(one.unit)}" for one, y in series]
    unit = square_of(case.outputs[0].unit)
    error = f"{case.measurement.error_name} {quantity(mse, unit, 4)}"
    yield finding("estimates", "ok", error=error, ranges=", ".join(ranges))
    yield from named("outputs-still", [one.name for one, y in series if np.ptp(y) <= SAME])
    if not case.scenario.n_warmup:
        yield from named("first-values", [one.name for one, y in series if _jumps(one.uncertainty, y)])
    problems = [(one.name, unit_problem(y, one.unit)) for one, y in series]
    yield from named(
        "units-of-outputs", [f"{name}: {problem}" for name, problem in problems if problem], "; "
    )


def corner_points(case: Case) -> FloatArray:
    """Return corners of the box, all lower and all upper bounds first. Shape (m, p). [per parameter]."""
    space = case.parameter_space
    sides = np.random.default_rng(DOCTOR_SEED).integers(0, 2, (4 * N_CORNERS, space.n_parameters))
    sides[0], sides[1] = 0, 1
    # Few parameters have few corners.
    _, first = np.unique(sides, axis=0, return_index=True)
    return space.from_unit(sides[np.sort(first)][:N_CORNERS].astype(np.float64))


def look_at_corners(answer: Trajectories) -> Finding:
    """Judge the answers at the corners of the box."""
    n_failed = int(answer.failed.sum())
    if not n_failed:
        return finding("corners", "ok", n=answer.n)
    level: Level = "fail" if n_failed == answer.n else "warn"
    return finding("corners-fail", level, n_failed=n_failed, n=answer.n, why=commonest(answer.failures)[0])


def coverage_points(case: Case) -> FloatArray:
    """Return points all over the box. Shape (m, p). [per parameter]."""
    return uniform_design(case.parameter_space, N_COVERAGE, DOCTOR_SEED)


def look_at_coverage(case: Case, answer: Trajectories) -> Finding:
    """Say how much of the measurement the box can produce."""
    n_failed, good = int(answer.failed.sum()), answer.y[~answer.failed]
    why, _ = commonest(answer.failures)
    if len(good) < 2 or n_failed > case.policy.max_failed_share * answer.n:
        return finding("box-fails", "fail", n_failed=n_failed, n=answer.n, why=why)
    inside = enclosed_fraction(case.measurement, good)
    failed = f", {n_failed} of {answer.n} failed; the reason: {why}" if n_failed else ""
    level: Level = "ok" if inside >= COVERED_SHARE else "warn"
    return finding("covered", level, inside=inside, n=answer.n, failed=failed)


def moved_points(case: Case, base: FloatArray) -> FloatArray:
    """Move each parameter to both of its ends, one at a time. Shape (2 p, p)."""
    space, p = case.parameter_space, len(base)
    theta = np.tile(base, (2 * p, 1))
    theta[2 * np.arange(p), np.arange(p)], theta[2 * np.arange(p) + 1, np.arange(p)] = space.ends(base)
    return theta


def influence(case: Case, nominal: Trajectories, answer: Trajectories) -> FloatArray:
    """Return how far each parameter moves an output.

    Args:
        case: the case.
        nominal: the answer that they are compared with, one row.
        answer: the answers to `moved_points`, or to the first of them.

    Returns:
        Largest change, NaN where both bounds failed. Shape (p,). [uncertainties]
    """
    moved = np.abs(answer.y - nominal.y[0]).max(axis=1) / case.measurement.uncertainty
    return np.asarray(np.fmax.reduce(moved.max(axis=1).reshape(-1, 2), axis=1))


def look_at_influence(case: Case, share: FloatArray, most: FloatArray) -> Finding:
    """Say whether every parameter moves an output.

    Args:
        case: the case.
        share: how far the first parameters move an output from the estimates, NaN where that is not known.
            Shape (p,). [uncertainties]
        most: the largest of this and the same from another point, where it was asked. Shape (p,).
            [uncertainties]
    """

    def which(is_so: np.ndarray) -> str:
        return ", ".join(case.parameter_space.names[i] for i in np.flatnonzero(is_so))

    if names := which(most <= SAME):
        return finding("no-effect", "fail", names=names)
    if names := which(share <= SAME):
        return finding("no-effect-here", names=names)
    if names := which(np.isnan(most)):
        return finding("effect-unknown", names=names)
    weak, least = which(most < UNSEEN_SHARE), int(np.argmin(most))
    values = {"least": case.parameter_space.names[least], "most": most[least], "names": weak}
    return finding("effect", "warn" if weak else "ok", **values)


def look_at_bounds(
    case: Case, base: FloatArray, answer: Trajectories, model: ForwardModel | None
) -> Iterator[Finding]:
    """Say which single parameters cannot be moved to a bound, from where on, and why.

    Args:
        case: The case.
        base: The estimates. Shape (p,). [per parameter]
        answer: The answers to `moved_points`, or to the first of them.
        model: Shows from where on a bound fails; None where there is no time for that.
    """
    failed, space = np.flatnonzero(answer.failed), case.parameter_space
    if not len(failed):
        return
    good, bad = np.tile(space.to_unit(base), (len(failed), 1)), space.to_unit(answer.theta[failed])
    for _ in range(N_HALVINGS):
        if model is not None:
            middle = 0.5 * (good + bad)
            is_good = ~model.simulate(space.from_unit(middle)).failed[:, None]
            good, bad = np.where(is_good, middle, good), np.where(is_good, bad, middle)
    regions = []
    for row, edge in zip(failed, space.from_unit(good), strict=True):
        one, bound = space.parameters[row // 2], answer.theta[row, row // 2]
        where, side = ("above", "upper") if row % 2 else ("below", "lower")
        begin = "" if model is None else f"{where} {edge[row // 2]:.3g}, "
        regions.append(
            f"{one.name} fails {begin}at its {side} bound {bound:.4g} {shown_unit(one.unit)}".rstrip()
        )
    share, reason = percent(len(failed) / answer.n), commonest(answer.failures)[0]
    yield from named("bounds-fail", regions, "; ", share=share, reason=reason)


def look_at_inputs(names: tuple[str, ...], nominal: Trajectories, answer: Trajectories) -> Finding:
    """Say whether every input moves an output.

    Args:
        names: inputs that were changed, one per row of the answer.
        nominal: the answer that they are compared with, one row.
        answer: answers to the estimates, each with one input changed.
    """
    moved = np.abs(answer.y - nominal.y[0]).max(axis=(1, 2))
    if dead := [name for name, most in zip(names, moved, strict=True) if most <= SAME]:
        return finding("inputs-no-effect", names=", ".join(dead))
    failed = [f"{name}: {reason}" for name, reason in zip(names, answer.failures, strict=True) if reason]
    if failed:
        return finding("inputs-fail", names=failed[0])
    return finding("inputs", "ok", names=", ".join(names))


def circumstances(case: Case, halved: Case, row: FloatArray) -> CircumstanceModel:
    """Collect the circumstances: as it is (0), half the step (1), each input changed (2, 3, ...)."""
    scenario = case.settings.scenario
    changed = []
    for column, name in enumerate(scenario.input_names):
        variable = case.fmu.variables[name]
        driving: list[Any] = [values.copy() for values in scenario.driving]
        for values in driving:
            values[:, column] = changed_input(values[:, column], variable)
        other = replace(scenario, **dict(zip(("inputs", "inputs_at_edges"), driving, strict=False)))
        changed.append(replace(case.settings, scenario=other))
    return CircumstanceModel((case.settings, halved.settings, *changed), row)


def look_at_halving(case: Case, halved: Case, nominal: Trajectories, answer: Trajectories) -> Finding:
    """Say what half the communication step changes."""
    step_s = halved.communication_step_s
    if answer.failed[0]:
        return finding("half-step-fails", step_s=step_s, reason=answer.failures[0])
    change = np.abs(answer.y[0] - nominal.y[0]).max(axis=0)
    shares = change / case.measurement.uncertainty
    worst = int(np.argmax(shares))
    output, share = case.outputs[worst], shares[worst]
    values = {"output": output.name, "change": change[worst], "unit": with_unit(output.unit), "share": share}
    return finding("half-step", "ok" if share <= STEP_SHARE else "warn", step_s=step_s, **values)


def changed_input(values: FloatArray, variable: FmuVariable) -> FloatArray:
    """Return other values of the same kind: in reverse order, so that a switch stays one.

    Args:
        values: Of an input. Shape (t - 1,). [case's unit]
        variable: The FMU's.
    """
    backwards = values[::-1]
    # Whole days of a clear sky are the same in reverse, but for rounding.
    if np.abs(backwards - values).max() > EVEN * np.ptp(values):
        return backwards
    if variable.kind not in REAL_KINDS:
        known = (0, 1) if variable.kind == "Boolean" else tuple(variable.items.values())
        other = next((number for number in known if number != values[0]), values[0] + 1.0)
        return np.full_like(values, other)
    shift = INPUT_SHARE * float(np.abs(values).max()) or 1.0
    return values + shift


def look_at_repeats(first: Trajectories, other: Trajectories) -> Finding:
    """Compare answers to the estimates.

    Args:
        first: the first answer of a process.
        other: the first answer of another process.
    """
    if other.failed[0]:
        return finding("repeats-fail", "fail", reason=other.failures[0])
    apart = float(np.max(np.abs(first.y - other.y)))
    if apart > SAME:
        return finding("random", "fail", apart=apart)
    return finding("repeats", "ok", exact="bit for bit" if apart == 0.0 else f"within {apart:.1g}")


def look_at_order(there: Trajectories, back: Trajectories) -> Finding:
    """Compare answers of two processes to the same rows, which they were given in reverse orders.

    What an FMU remembers of a simulation falsifies the next one.

    Args:
        there: the answers of one process.
        back: those of the other one, in the order of the first.
    """
    is_other = differ(there, back)
    failed_once = np.flatnonzero(there.failed != back.failed)
    # On a busy machine that is no sign of what the FMU keeps.
    if any(STOPPED in there.failures[row] + back.failures[row] for row in failed_once):
        return finding("order-timeout", remedy=MORE_TIME)
    if not is_other.any():
        return finding("order", "ok", n=there.n)
    apart = np.abs(there.y - back.y)
    largest = float(np.max(apart, where=np.isfinite(apart), initial=0.0))
    return finding("forgets-not", n=there.n, n_other=int(is_other.sum()), largest=largest)


def differ(one: Trajectories, other: Trajectories) -> BoolArray:
    """Return which of the same rows differ in a bit, or failed in one of two processes alone. Shape (n,)."""
    is_other = np.any(one.y != other.y, axis=(1, 2)) & ~one.failed & ~other.failed
    return np.asarray(is_other | (one.failed != other.failed))


def _jumps(uncertainty: float, values: FloatArray) -> bool:
    """Say whether the first value is off by more than all others differ. Shape of values (t,)."""
    step = abs(float(values[0] - values[1]))
    return len(values) > 2 and step > max(10.0 * uncertainty, float(np.ptp(values[1:])))


def _remedy(reason: str) -> str:
    return next((to_do for sign, to_do in _REMEDIES.items() if sign in reason.lower()), _GENERAL_REMEDY)
