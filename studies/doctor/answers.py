"""What the model's answers say: estimates, box, influences, and the same again in other circumstances."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.pool.execution import commonest
from simulation.trajectories import Trajectories
from studies.circumstances import CircumstanceModel
from studies.doctor.asking import Asked, TimedModel
from studies.doctor.declared import undeclared, unit_problem
from studies.doctor.effects import SAME
from studies.doctor.finding import LONGEST, MORE_TIME, STOPPED, Finding, Level, finding, named
from studies.reporting.figures_model import enclosed_fraction
from studies.words.wording import count, percent, quantity, shown_unit, square_of

N_CORNERS, N_COVERAGE = 32, 64
DOCTOR_SEED = 12_345
N_HALVINGS = 5
"""Rows that find out from where on a bound fails: to 1/32 of the way to it."""
WIDE = 1e4
"""Bounds with such a ratio are too wide for N_COVERAGE points to show what the box can produce."""
COVERED_SHARE = 0.9
"""Part of the measurement that should lie within the simulated envelope."""
STEP_SHARE = 0.2
"""Halving the communication step may change the output by this share of the sensor's uncertainty."""
INPUT_SHARE = 0.1
"""A constant input is changed by this share of its size."""
DIVERGED = 1e4
"""A difference of so many times the measured span is no fit: the simulation diverges, or a unit is wrong."""
EVEN = 1e-3
"""An input that differs by this share of its range from its reverse is the same in reverse."""
_REMEDIES = {
    "accepted": "check the units of inputs and parameters; or widen accepted of that output",
    STOPPED: MORE_TIME,
    "licen": "see that the licence can be reached from here; how many at once: [simulation] max_workers",
    "shared object": "install the system library that it names, or export the FMU with its libraries inside",
}
"""What to do, by a sign in the reason of a failure."""
_GENERAL_REMEDY = (
    "first check values and units of inputs, parameters and [fixed]{bare}; then try the FMU in another tool"
)


def with_unit(unit: str) -> str:
    """Return a unit as it stands behind a number."""
    return "" if unit in ("", "1") else f" {unit}"


def cannot_open(reason: str) -> Finding:
    """Say what to do about an FMU that cannot be opened: the reason may know it."""
    found, separator, own = reason.rpartition("; ")
    remedy = _known_remedy(reason)
    if not remedy and separator:
        reason, remedy = found, own
    return finding("cannot-open", "fail", reason=reason, remedy=remedy or "try the FMU in another tool")


def middle_fails(case: Case, middle: Trajectories) -> Finding:
    """Say that the middle of the box fails, which is no estimate."""
    reason = middle.failures[0]
    return finding("middle-fails", reason=reason, remedy=_remedy(reason, case))


def look_at_estimates(case: Case, nominal: Trajectories, n_points: int = 0) -> Iterator[Finding]:
    """Judge the answer to the estimates.

    Args:
        case: The case.
        nominal: The answer, one row.
        n_points: Points of which it is the best, where the case has no estimates; 0 where it has.
    """
    if reason := nominal.failures[0]:
        yield finding("estimates-fail", "fail", reason=reason, remedy=_remedy(reason, case))
        return
    mse = float(case.measurement.mse(nominal.y)[0])
    series = list(zip(case.outputs, nominal.y[0].T, strict=True))
    ranges = [f"{one.name} from {y.min():.4g} to {y.max():.4g}{with_unit(one.unit)}" for one, y in series]
    unit = square_of(case.outputs[0].unit)
    error = f"{case.measurement.error_name} {quantity(mse, unit, 4)}"
    which = f"none for some parameters; at the best of {count(n_points, 'point')}: " if n_points else ""
    values = {"which": which, "error": error, "ranges": ", ".join(ranges)}
    if _diverges(case, nominal.y):
        yield finding("estimates-diverge", "warn", **values, other=_other_interface(case))
    else:
        yield finding("estimates", "ok", **values)
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


def look_at_corners(answer: Trajectories) -> Iterator[Finding]:
    """Judge the answers at the corners of the box, where there are any."""
    n_failed = int(answer.failed.sum())
    if not n_failed:
        yield from [finding("corners", "ok", n=answer.n)] * bool(answer.n)
        return
    level: Level = "fail" if n_failed == answer.n else "warn"
    yield finding("corners-fail", level, n_failed=n_failed, n=answer.n, why=commonest(answer.failures)[0])


def coverage_points(case: Case) -> FloatArray:
    """Return points all over the box, even in each parameter's scale. Shape (m, p). [per parameter]."""
    space = case.parameter_space
    u = np.random.default_rng(DOCTOR_SEED).random((N_COVERAGE, space.n_parameters))
    return space.from_unit(u)


def look_at_coverage(case: Case, found: Asked, known: Trajectories) -> Iterator[Finding]:
    """Say how much of the measurement the box can produce.

    Few simulations can show that it is covered, and never that it is not.

    Args:
        case: The case.
        found: The answers to `coverage_points`, or to the first of them.
        known: All good simulations of the box, these among them.
    """
    answer, is_whole = found.answer, found.n == N_COVERAGE and found.is_whole
    n_failed, (why, _) = int(answer.failed.sum()), commonest(answer.failures)
    share = case.policy.max_failed_share
    is_hopeless = n_failed > share * answer.n if is_whole else case.policy.is_hopeless(answer.n, n_failed)
    if is_hopeless or (is_whole and answer.n - n_failed < 2):
        yield finding("box-fails", "fail", n_failed=n_failed, n=answer.n, why=why)
        return
    inside = enclosed_fraction(case.measurement, known.y)
    failed = f", {n_failed} of {answer.n} failed; the reason: {why}" if n_failed else ""
    is_covered = inside >= COVERED_SHARE
    ratios = [(one.upper / one.lower, one) for one in case.parameter_space.parameters if one.scale == "log"]
    widest = max((ratio for ratio, _ in ratios), default=1.0)
    if not is_covered and widest >= WIDE:
        values = {"widest": f"{np.log10(widest):.2g} decades", "failed": failed}
        yield finding("covered-wide", "ok", inside=inside, n=known.n, **values)
    elif is_covered or is_whole:
        level: Level = "ok" if is_covered else "warn"
        yield finding("covered", level, inside=inside, n=known.n, failed=failed)


def look_at_bounds(
    case: Case, base: FloatArray, answer: Trajectories, rows: IntArray, model: TimedModel | None
) -> Iterator[Finding]:
    """Say which single parameters cannot be moved to a bound, from where on, and why.

    Args:
        case: The case.
        base: The estimates. Shape (p,). [per parameter]
        answer: The answers to some of `moved_points`, m rows.
        rows: Which of them. Shape (m,).
        model: Shows from where on a bound fails; None where there is no time for that.
    """
    failed, space = np.flatnonzero(answer.failed), case.parameter_space
    if not len(failed):
        return
    good, bad = np.tile(space.to_unit(base), (len(failed), 1)), space.to_unit(answer.theta[failed])
    for _ in range(N_HALVINGS):
        if model is not None:
            middle = 0.5 * (good + bad)
            found = model.ask(space.from_unit(middle), "from where on bounds fail")
            if not found.is_whole:
                # Which half fails is not known of all.
                model = None
                break
            is_good = ~found.answer.failed[:, None]
            good, bad = np.where(is_good, middle, good), np.where(is_good, bad, middle)
    regions = []
    for row, edge in zip(failed, space.from_unit(good), strict=True):
        moved, at = divmod(int(rows[row]), 2)
        one, bound = space.parameters[moved], answer.theta[row, moved]
        where, side = ("above", "upper") if at else ("below", "lower")
        begin = "" if model is None else f"{where} {edge[moved]:.3g}, "
        regions.append(
            f"{one.name} fails {begin}at its {side} bound {bound:.4g} {shown_unit(one.unit)}".rstrip()
        )
    share, reason = percent(len(failed) / answer.n), commonest(answer.failures)[0]
    yield from named("bounds-fail", regions, "; ", share=share, reason=reason)


def look_at_inputs(names: Sequence[str], nominal: Trajectories, answer: Trajectories) -> Finding:
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
    level: Level = "ok" if share <= STEP_SHARE else "warn"
    return finding("half-step", level, step_s=step_s, other=_other_interface(case), **values)


def _diverges(case: Case, y: FloatArray) -> bool:
    """Say whether a measured output is out of all proportion to what was measured. y of shape (1, t, k)."""
    for k in case.measurement.measured:
        span = np.ptp(case.outputs[k].samples.values) + case.outputs[k].uncertainty
        if np.abs(case.measurement.differences(y, k)).max() > DIVERGED * span:
            return True
    return False


def _other_interface(case: Case) -> str:
    """Return the advice to let a solver of ours step an FMU whose own solver is too coarse."""
    is_coarse = case.interface == "co-simulation" and "model-exchange" in case.fmu.interfaces
    return ', or write interface = "model-exchange"' * is_coarse


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


def _remedy(reason: str, case: Case) -> str:
    """Say what to do about a simulation that fails; undeclared units come first."""
    names = undeclared(case)
    more = f" and {len(names) - LONGEST} more" if len(names) > LONGEST else ""
    bare = f" (the FMU declares no unit of {', '.join(names[:LONGEST])}{more})" if names else ""
    return _known_remedy(reason) or _GENERAL_REMEDY.format(bare=bare)


def _known_remedy(reason: str) -> str:
    return next((to_do for sign, to_do in _REMEDIES.items() if sign in reason.lower()), "")
