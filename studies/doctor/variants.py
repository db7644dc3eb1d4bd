"""The same FMU in other circumstances: each input changed, half the communication step."""

from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.trajectories import Trajectories
from studies.circumstances import CircumstanceModel
from studies.doctor.answers import with_unit
from studies.doctor.finding import Finding, finding

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
