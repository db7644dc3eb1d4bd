"""Switches that an FMU shows: other variables of two values, such as a heater's power, on or off.

Their positions count as further states, which stand still between changes. So a derivative may have terms
with them, and solved equations carry them along (flow_steps.py).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.state_equations.states import StateRows, StateSignals


class SwitchPositions:
    """The variables of two values among those that are watched, as far as rows have shown them."""

    def __init__(self, signals: StateSignals) -> None:
        """Begin without rows."""
        self._names = np.array(signals.locals, dtype=np.str_)
        self._places = np.arange(len(signals.locals))
        self._rows: list[FloatArray] = []

    def note(self, values: FloatArray | None) -> None:
        """See more rows, and forget what has more than two values in one. Shape (n, t, l)."""
        if values is None or not self._names.size:
            return
        values = values[..., self._places]
        low, high = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
        kept = ((values == low) | (values == high)).all(axis=(0, 1))
        self._rows = [rows[..., kept] for rows in [*self._rows, values]]
        self._places, self._names = self._places[kept], self._names[kept]

    def known(self) -> dict[str, FloatArray]:
        """Return positions, 0 or 1, of the switches that are no schedules, by name. Shapes (n, t)."""
        found = dict[str, FloatArray]()
        if not self._rows:
            return found
        for name, values in zip(
            self._names.tolist(), np.concatenate(self._rows).transpose(2, 0, 1), strict=True
        ):
            low, high = values.min(), values.max()
            is_shared = ((values == low) | (values == high)).all()
            # A power is 0 or a parameter of the row.
            if not is_shared and not (values.min(axis=1) * values.max(axis=1) == 0.0).any():
                continue
            position = (values == high if is_shared else values != 0.0).astype(float)
            is_schedule = (position == position[0]).all()
            is_copy = any(
                np.array_equal(position, one) or np.array_equal(position, 1.0 - one) for one in found.values()
            )
            if not is_schedule and not is_copy:
                found[name] = position
        return found


def with_switches(signals: StateSignals, switches: Sequence[str]) -> StateSignals:
    """Return signals with switches as further states."""
    n, more = len(signals.states), frozenset(switches)
    return replace(
        signals,
        states=(*signals.states, *switches),
        derivatives=(*signals.derivatives, *(f"der({name})" for name in switches)),
        units=(*signals.units[:n], *["1"] * len(switches), *signals.units[n:]),
        # They are no states of the FMU, so that its declared dependencies do not name them.
        depends_on=(
            *(None if one is None else one | more for one in signals.depends_on),
            *[frozenset[str]()] * len(switches),
        ),
        n_switches=len(switches),
    )


def with_positions(rows: StateRows, positions: Sequence[FloatArray]) -> StateRows:
    """Return rows with positions of switches, shapes (n, t), as states that stand still."""
    if not positions:
        return rows
    x = np.stack(positions, axis=-1)
    return StateRows(
        np.concatenate([rows.x, x], axis=-1), np.concatenate([rows.slope, np.zeros_like(x)], axis=-1), rows.y
    )
