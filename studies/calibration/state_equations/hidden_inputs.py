"""Inputs that an FMU hides: variables that follow time and not the parameters, as weather inside the model.

They are known at the outputs alone. What they do in between is smooth but where they jump, and a jump lies
anywhere between two outputs; solved equations show where (identification.py).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from simulation.arrays import BoolArray, FloatArray
from simulation.units import in_si
from studies.calibration.state_equations.states import StateSignals

# Squares of a signal, as a share of all, by which it may differ in two rows or from a sum of others.
SAME = 1e-10
# A change or a deviation over time of this share of a signal's magnitude is none.
AT_REST = 1e-9
# A change between two outputs so many times greater than those before and after it is a jump.
JUMP = 3.0
# Places between two outputs at which a jump is looked for.
MOST_PLACES = 6


class LocalVariables:
    """The variables of an FMU that are watched beside its states, as far as rows have shown them."""

    def __init__(self, signals: StateSignals) -> None:
        """Begin without rows."""
        self._signals = signals
        self._first: FloatArray | None = None
        self._follow_time = np.ones(len(signals.locals), dtype=np.bool_)

    def note(self, values: FloatArray | None) -> None:
        """See what they do in more rows, and forget which follow the parameters. Shape (n, t, l)."""
        if values is None or not self._follow_time.any():
            return
        if self._first is None:
            self._first = values[0]
        with np.errstate(all="ignore"):
            one = self._first - self._first.mean(axis=0)
            other = values - values.mean(axis=1, keepdims=True)
            size, along = np.square(one).sum(axis=0), np.einsum("tl,ntl->nl", one, other)
            # A gain that a parameter scales follows time as well: its coefficient takes the scale.
            left = 1.0 - along**2 / (size * np.square(other).sum(axis=1))
            is_moving = size > (AT_REST * np.abs(self._first).max(axis=0)) ** 2 * len(one)
            self._follow_time &= is_moving & (np.abs(left) <= SAME).all(axis=0)

    def as_inputs(self) -> StateSignals:
        """Return the signals with those variables as inputs that neither inputs nor others make up."""
        signals = self._signals
        if self._first is None:
            return signals
        of_states = signals.units[: len(signals.states)]
        found = [
            (signals.locals[one], *_in_units_of(of_states, signals.local_units[one], self._first[:, one]))
            for one in np.flatnonzero(self._follow_time).tolist()
        ]
        # What has a state's unit makes differences to it: it goes before what is made of it.
        found.sort(key=lambda one: one[1] not in of_states)
        values = [*signals.at_outputs.T, *(one[2] for one in found)]
        kept = [
            found[place - len(signals.inputs)] for place in _unlike(values) if place >= len(signals.inputs)
        ]
        seen = np.array([one[2] for one in kept]).reshape(-1, len(self._first)).T
        return replace(
            signals,
            inputs=(*signals.inputs, *(one[0] for one in kept)),
            units=(*signals.units, *(one[1] for one in kept)),
            driven=np.concatenate([signals.driven, Course(seen, signals.every).driven], axis=1),
            seen=np.concatenate([signals.at_outputs, seen], axis=1),
            n_hidden=len(kept),
        )


def _unlike(columns: list[FloatArray]) -> list[int]:
    """Return the positions of signals, shape (t,) each, that are no sum of a constant and those before."""
    kept, axes = list[int](), np.empty((len(columns[0]) if columns else 0, 0))
    for place, values in enumerate(columns):
        rest = values - values.mean()
        size = float(rest @ rest)
        # Twice is enough for all digits.
        # (Gram-Schmidt, repeated once: Giraud and others 2005, doi:10.1007/s00211-005-0615-4.)
        for _ in range(2):
            rest = rest - axes @ (axes.T @ rest)
        if float(rest @ rest) > SAME * size:
            kept.append(place)
            axes = np.column_stack([axes, rest / np.sqrt(rest @ rest)])
    return kept


def _in_units_of(of_states: tuple[str, ...], unit: str, values: FloatArray) -> tuple[str, FloatArray]:
    """Return a signal's unit and values, those of degC in K where the states are."""
    si = in_si(unit) if unit else None
    if si is None or not si.offset or unit in of_states:
        return unit, values
    return "K", values * float(si.factor) + float(si.offset)


@dataclass(frozen=True, eq=False)
class Course:
    """What hidden inputs do between the outputs.

    Attributes:
        seen: Their values at the outputs. Shape (t, h). [FMU's units]
        every: Communication steps from one output to the next.
        choices: Which of them jump between all outputs, and communication steps after an output before each
            one jumps; as far as they do so otherwise than at jumps, and at the next output.
    """

    seen: FloatArray
    every: int
    choices: Mapping[int, tuple[bool, int]] = field(default_factory=dict)

    @property
    def driven(self) -> FloatArray:
        """Their means over the communication steps. Shape (m, h). [FMU's units]."""
        columns = [_means(values, self.every, *self._choice(one)) for one, values in enumerate(self.seen.T)]
        return np.column_stack(columns) if columns else np.empty(((len(self.seen) - 1) * self.every, 0))

    def others(self, one: int) -> list["Course"]:
        """Return other courses of one of them."""
        places = np.linspace(0, self.every, min(self.every, MOST_PLACES) + 1).round().astype(int).tolist()
        kinds = (False, True) if _jumps(self.seen[:, one]).any() else (True,)
        return [
            replace(self, choices={**self.choices, one: other})
            for other in product(kinds, places)
            if other != self._choice(one)
        ]

    def _choice(self, one: int) -> tuple[bool, int]:
        return self.choices.get(one, (False, self.every))


def _jumps(values: FloatArray) -> BoolArray:
    """Return after which of the values (t,) a jump follows. Shape (t - 1,)."""
    change = np.abs(np.diff(values))
    beside = np.pad(change, 1)
    return np.asarray(change > JUMP * (beside[:-2] + beside[2:]) + AT_REST * np.abs(values).max())


def _means(values: FloatArray, every: int, is_held: bool, place: int) -> FloatArray:
    """Return a signal's means over the communication steps, from values at the outputs (t,). Shape (m,)."""
    jumps = np.ones(len(values) - 1, dtype=np.bool_) if is_held else _jumps(values)
    means = np.empty((len(values) - 1, every))
    means[:, :place], means[:, place:] = values[:-1, None], values[1:, None]
    # No curve runs across a jump, where it would swing.
    ends = np.flatnonzero(np.concatenate([jumps, [True]])) + 1
    for first, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
        if end - first > 1:
            at = np.arange(first, end, dtype=np.float64)
            edges = first + np.arange((end - first - 1) * every + 1) / every
            # The integral gives exact means over steps; Akima's curve
            # swings little beside bends (1970, doi:10.1145/321607.321609).
            whole = Akima1DInterpolator(at, values[first:end]).antiderivative()(edges)
            means[first : end - 1] = (np.diff(whole) * every).reshape(-1, every)
    return means.reshape(-1)
