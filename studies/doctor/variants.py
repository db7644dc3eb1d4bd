"""The same FMU again and in other circumstances: after other rows, other inputs, half the step."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.trajectories import Trajectories
from studies.circumstances import CircumstanceModel
from studies.doctor.answers import SAME, with_unit
from studies.doctor.finding import Finding, finding
from studies.doctor.storing import MORE_TIME, STOPPED

STEP_SHARE = 0.2
"""Halving the communication step may change the output by this share of the sensor's uncertainty."""
INPUT_SHARE = 0.1
"""A constant input is changed by this share of its size."""
EVEN = 1e-3
"""An input that differs by this share of its range from its reverse is the same in reverse."""


def circumstances(case: Case, halved: Case, row: FloatArray) -> CircumstanceModel:
    """Collect the circumstances: as it is (0), half the step (1), each input changed (2, 3, ...)."""
    scenario = case.settings.scenario
    changed = []
    for column, name in enumerate(scenario.input_names):
        variable = case.fmu.variables[name]
        over_steps, at_edges = scenario.inputs.copy(), scenario.inputs_at_edges
        over_steps[:, column] = changed_input(over_steps[:, column], variable)
        if at_edges is not None:
            at_edges = at_edges.copy()
            at_edges[:, column] = changed_input(at_edges[:, column], variable)
        other = replace(scenario, inputs=over_steps, inputs_at_edges=at_edges)
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
    return np.asarray(values + shift)


def look_at_repeats(first: Trajectories, again: Sequence[Trajectories], fresh: Trajectories) -> Finding:
    """Compare answers to the estimates.

    Args:
        first: the first answer of a process.
        again: later answers of the same process, other rows in between.
        fresh: the first answer of another process.
    """
    if reason := next((one.failures[0] for one in (*again, fresh) if one.failed[0]), ""):
        return finding("repeats-fail", "fail", reason=reason)
    between, within = _apart(first, fresh), max((_apart(first, one) for one in again), default=0.0)
    if between > SAME:
        return finding("random", "fail", apart=between)
    if within > SAME:
        return finding("keeps-a-state", "fail", apart=within)
    most = max(between, within)
    return finding("repeats", "ok", exact="bit for bit" if most == 0.0 else f"within {most:.1g}")


def look_at_order(later: Trajectories, first: Trajectories) -> Finding:
    """Compare answers to a point of the box: what a process keeps of its first row falsifies all others.

    Args:
        later: the answer of a process that answered another row before.
        first: the first answer of another process.
    """
    if later.failed[0] and first.failed[0]:
        return finding("order", "ok", said="a point of the box fails, first and later")
    # On a busy machine that is no sign of what the FMU keeps.
    if any(STOPPED in answer.failures[0] for answer in (later, first)):
        return finding("order-timeout", remedy=MORE_TIME)
    apart = _apart(later, first)
    if apart <= SAME:
        return finding("order", "ok", said="first in a process, and after other parameters")
    said = f"the same parameters give outputs {apart:.3g} apart first in a process and after others"
    if np.isnan(apart):
        said = "a point of the box fails either first in a process or after others, not both"
    return finding("keeps-first-parameters", "fail", said=said)


def _apart(one: Trajectories, other: Trajectories) -> float:
    return float(np.max(np.abs(one.y - other.y)))
