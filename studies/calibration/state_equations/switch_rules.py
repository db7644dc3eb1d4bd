"""When switches change: thresholds of a state or a difference, one for each direction, found in simulations.

A simulation shows between which two outputs a switch changes. The equations are exact on either side of the
change: solved forward from the output before, in the old position, and backward from the output after, in the
new one, they meet where it changes. What has the same value at all changes of a row is the threshold. A
switch may have to wait since its last change, too; then it changes beyond its threshold.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from simulation.arrays import FloatArray, IntArray
from studies.calibration.state_equations.flow import MOST_PARTS, SteppedFlow
from studies.calibration.state_equations.hidden_inputs import AT_REST
from studies.calibration.state_equations.states import StateSignals
from studies.calibration.state_equations.terms import Sum

# Distance of both solutions where they meet, as a share of what it is where they
# begin: beyond, the switch has changed more than once between two outputs.
MEETS = 1e-4
# By how much of its deviation over time a threshold may differ between the changes
# of a row, and a waiting time relative to itself.
SAME_VALUE, SAME_WAIT = 1e-4, 1e-5
# So many changes of a row are looked at.
MOST_CHANGES = 40


class _Change(NamedTuple):
    """A change of a switch.

    Attributes:
        waited_s: Time since the change before, NaN where that is not known. [s]
        before: States, inputs, 1 and 0 at the output before. Shape (s + q + 2,).
        there: States, inputs, 1 and 0 at the change. Shape (s + q + 2,).
    """

    waited_s: float
    before: FloatArray
    there: FloatArray


class _Rule(NamedTuple):
    """When a switch changes from one position.

    Attributes:
        value: Position of what is compared with the threshold, among states, inputs, 1 and 0.
        less: Position of what is subtracted from it.
        sign: 1 where it changes above its threshold, -1 below.
        thresholds: Of every row, NaN where it is open. Shape (n,).
        waits: Shortest times between changes. Shape (n,). [s]
    """

    value: int
    less: int
    sign: int
    thresholds: FloatArray
    waits: FloatArray


def switch_rules(
    signals: StateSignals, derivatives: tuple[Sum, ...], x: FloatArray, rates: Sequence[FloatArray]
) -> tuple[IntArray, FloatArray] | str:
    """Find when the switches of some rows change.

    Args:
        signals: What is known of the states, the switches the last of them.
        derivatives: Their terms.
        x: The rows' states. Shape (n, t, s).
        rates: Coefficients of every derivative's terms. Shapes (n, terms).

    Returns:
        The rules, see `flow_steps.steps`, shape (r, 5); and thresholds and then shortest times between
        changes, 0 for none, NaN where a row leaves them open, shape (n, 2 r). In words, why there are none.
    """
    n_states, coefficients = len(signals.states), np.concatenate(rates, axis=1)
    flow = SteppedFlow(signals, derivatives, n_parts=MOST_PARTS)
    places, found = list[list[int]](), list[_Rule]()
    for switch in range(signals.n_continuous, n_states):
        by_row = [_changes(flow, row, known, switch) for row, known in zip(x, coefficients, strict=True)]
        for position in (0, 1):
            changes = [[one for one in row if one.before[switch] == position] for row in by_row]
            if not any(changes):
                continue
            rule = _rule(signals, x, changes)
            if rule is None:
                return f"{signals.states[switch]} changes at no threshold that was found"
            places.append([switch, position, rule.value, rule.less, rule.sign])
            found.append(rule)
    limits = [*(rule.thresholds for rule in found), *(rule.waits for rule in found)]
    return np.array(places, dtype=np.int64).reshape(-1, 5), np.array(limits).reshape(-1, len(x)).T


def _changes(flow: SteppedFlow, x: FloatArray, coefficients: FloatArray, switch: int) -> list[_Change]:
    """Locate the changes of a switch in a row's states (t, s)."""
    signals = flow.signals
    # As in solved equations, the first output counts as a change.
    found, last = list[_Change](), 0.0
    scale = x.std(axis=0)
    # Switches jump where the others meet, and what is at rest shows nothing.
    scale[signals.n_continuous :] = 0.0
    weight = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    firsts = np.flatnonzero(np.diff(x[:, switch]))
    for first in firsts[:MOST_CHANGES].tolist():
        driven = signals.driven[first * signals.every : (first + 1) * signals.every]
        located = _located(flow, (x[first], x[first + 1]), coefficients, driven, weight)
        if located is None:
            last = np.nan
            continue
        step, after_s, state = located
        now = (first * signals.every + step) * signals.step_s + after_s
        others = [*driven[step], 1.0, 0.0]
        found.append(_Change(now - last, np.array([*x[first], *others]), np.array([*state, *others])))
        last = now
    return found


def _located(
    flow: SteppedFlow,
    ends: tuple[FloatArray, FloatArray],
    coefficients: FloatArray,
    driven: FloatArray,
    weight: FloatArray,
) -> tuple[int, float, FloatArray] | None:
    """Find where solutions from either end of an output step meet.

    Returns:
        In which communication step, how long after its begin, and the states there; None where they do not.
    """

    def states(start: FloatArray, inputs: FloatArray, length_s: float) -> FloatArray:
        return np.asarray(flow.solved(start[None], coefficients[None], inputs, length_s, 1)[0])

    step_s = flow.signals.step_s
    old, new = states(ends[0], driven, step_s), states(ends[1], driven[::-1], -step_s)[::-1]
    apart = (old - new) * weight
    along = apart[-1] - apart[0]
    signed = apart @ along
    crossed = np.flatnonzero((signed[:-1] <= 0.0) & (signed[1:] >= 0.0))
    if not crossed.size or not np.isfinite(signed).all():
        return None
    step = int(crossed[0])
    inputs = driven[[step]]

    def apart_after(length_s: float) -> FloatArray:
        here = states(old[step], inputs, length_s)[1] - states(new[step], inputs, length_s)[1]
        return np.asarray(here * weight)

    def along_after(length_s: float) -> float:
        return float(apart_after(length_s) @ along)

    # The solutions drift apart nearly evenly, so that along their way apart there is one root, which
    # rounding may put beyond an end.
    if along_after(0.0) >= 0.0:
        after_s = 0.0
    elif along_after(step_s) <= 0.0:
        after_s = step_s
    else:
        after_s = brentq(along_after, 0.0, step_s, xtol=1e-9 * step_s)
    if np.linalg.norm(apart_after(after_s)) > MEETS * np.linalg.norm(along):
        return None
    return step, after_s, states(old[step], inputs, after_s)[1]


def _rule(signals: StateSignals, x: FloatArray, changes: Sequence[Sequence[_Change]]) -> _Rule | None:
    """Find what has one value at the changes of every row, first without waiting times."""
    n_states, nothing = len(signals.states), len(signals.states) + len(signals.inputs) + 1
    n_own = signals.n_continuous
    # A state, or its difference to a state or an input.
    pairs = [(one, nothing) for one in range(n_own)] + [
        (one, other)
        for one in range(n_own)
        for other in (*range(one + 1, n_own), *range(n_states, nothing - 1))
        if signals.units[one] == signals.units[other]
    ]
    for waits in (False, True):
        judged = [_judged(x, changes, value, less, waits=waits) for value, less in pairs]
        if found := [one for one in judged if one is not None]:
            # A difference to what is at rest is no better than the state alone.
            return min(found, key=lambda one: (one[1].less != nothing, one[0]))[1]
    return None


def _judged(
    x: FloatArray, changes: Sequence[Sequence[_Change]], value: int, less: int, *, waits: bool
) -> tuple[float, _Rule] | None:
    """Return by how much a threshold differs in rows and the rule, None where there is no such threshold."""
    if waits:
        # Whether a change had to wait is not known after one that was not located.
        changes = [[one for one in row if np.isfinite(one.waited_s)] for row in changes]
    there = [np.array([one.there[value] - one.there[less] for one in row]) for row in changes]
    moved = [
        np.array([one.before[less] - one.before[value] for one in row]) + there[n]
        for n, row in enumerate(changes)
    ]
    sign = 1 if sum(np.sign(row).sum() for row in moved) >= 0 else -1
    scale = float(np.median(x[..., value].std(axis=1)))
    # What is at rest has the same value at all changes and at all other times.
    if scale <= AT_REST * float(np.abs(x[..., value]).max()):
        return None
    thresholds, shortest = np.full(len(x), np.nan), np.full(len(x), np.nan if waits else 0.0)
    worst, is_tested = 0.0, False
    for n, (shown, row) in enumerate(zip(there, changes, strict=True)):
        waited = np.array([one.waited_s for one in row])
        least = np.nanmin(waited, initial=np.inf)
        is_bound = waited <= least * (1.0 + SAME_WAIT) if waits else np.zeros(len(row), dtype=np.bool_)
        free = shown[~is_bound]
        is_tested |= free.size > 1
        if free.size:
            thresholds[n] = free.mean()
            worst = max(worst, float(np.ptp(free)) / scale)
            beyond = sign * (shown[is_bound] - thresholds[n]) / scale
            if (beyond < -SAME_VALUE).any():
                return None
            has_waited = bool((beyond > SAME_VALUE).any())
        else:
            has_waited = bool(is_bound.sum() > 1)
        if waits and has_waited:
            shortest[n] = least
    if worst > SAME_VALUE or not is_tested:
        return None
    return worst, _Rule(value, less, sign, thresholds, shortest)
