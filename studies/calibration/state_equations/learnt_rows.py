"""The rows of one experiment that state equations are learnt from."""

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.growing_rows import GrowingRows
from studies.calibration.state_equations.hidden_inputs import LocalVariables
from studies.calibration.state_equations.states import StateRows, StateSignals
from studies.calibration.state_equations.switch_positions import SwitchPositions, with_positions


class LearntRows:
    """Rows whose states are known.

    Attributes:
        u: Their points. Shape (n, p). [1]
        hidden: The variables that follow time alone in all of them.
        switches: The variables of two values.
    """

    def __init__(self, signals: StateSignals, n_parameters: int, n_residuals: int) -> None:
        """Begin without rows.

        Args:
            signals: What is known of the states.
            n_parameters: Parameters p.
            n_residuals: Residuals m of a row.
        """
        self.u = np.empty((0, n_parameters))
        self.hidden, self.switches = LocalVariables(signals), SwitchPositions(signals)
        self._states, self._residuals = list[StateRows](), GrowingRows(n_residuals)

    @property
    def residuals(self) -> FloatArray:
        """Simulated residuals. Shape (n, m). [first output's unit]."""
        return self._residuals.rows

    def add(self, u: FloatArray, rows: StateRows, residuals: FloatArray) -> None:
        """Add rows: points (k, p), what states did there, and residuals (k, m)."""
        self.u = np.concatenate([self.u, u])
        self._residuals.add(residuals)
        self._states.append(rows._replace(locals=None))
        self.hidden.note(rows.locals)
        self.switches.note(rows.locals)

    def states(self, signals: StateSignals) -> StateRows:
        """Return what states and outputs did in all rows, the signals' switches among the states."""
        # The fourth part, other variables, is None.
        x, slope, y, _ = zip(*self._states, strict=True)
        rows = StateRows(np.concatenate(x), np.concatenate(slope), np.concatenate(y))
        positions = self.switches.known()
        return with_positions(rows, [positions[name] for name in signals.states[signals.n_continuous :]])

    def hold(self, u: FloatArray) -> BoolArray:
        """Return which points (n, p) are among them. Shape (n,)."""
        return np.asarray((self.u == u[:, None]).all(axis=2).any(axis=1))
