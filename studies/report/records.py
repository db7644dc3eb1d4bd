"""What figures and tables draw: frozen records of plain arrays and strings, and nothing that draws.

Every record is filled by the caller from stored results, so that a report can be rebuilt from files alone.
Shapes use t time steps, k outputs, p parameters, n parameter sets, h history entries.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulation.measurement import Measurement, Samples
from studies.calibration.ledger import Ledger
from studies.report.wording import difference_unit, squared

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

Method = Literal["paper", "adaptive"]


@dataclass(frozen=True)
class MeasuredSeries:
    """The measurement a case is calibrated against.

    Attributes:
        measurement: What was measured of the k outputs and when; its output times are the time axis of every
            trajectory in the report.
        units: Unit of each output as declared by the case, e.g. "degC".
    """

    measurement: Measurement
    units: tuple[str, ...]

    @property
    def time(self) -> Floats:
        """Output times. Shape (t,). [s]."""
        return self.measurement.time

    @property
    def mse_unit(self) -> str:
        """Unit of an MSE: the first output's, squared."""
        return squared(difference_unit(self.units[0]))

    @property
    def output_names(self) -> tuple[str, ...]:
        """One name per output."""
        return self.measurement.output_names

    @property
    def uncertainty(self) -> Floats:
        """Sensor uncertainty, plus or minus; NaN where undeclared. Shape (k,). [units, differences]."""
        return self.measurement.uncertainty

    @property
    def samples(self) -> tuple[Samples, ...]:
        """What was measured of each output: times and values, gaps left out."""
        return self.measurement.samples

    def residual(self, y: Floats, output: int) -> Floats:
        """Return simulated minus measured at the samples of an output.

        Args:
            y: A trajectory. Shape (t, k). [units]
            output: Position of the output.

        Returns:
            Shape (m,). [units, differences]
        """
        residual: Floats = self.measurement.differences(y[None], output)[0]
        return residual


@dataclass(frozen=True, eq=False)  # arrays cannot be compared: a record equals itself alone
class CalibrationRecord:
    """One calibration: screened on a surrogate and polished, or adaptive on the physical model alone.

    An adaptive one has no training set and no screened point: zero calls and NaN where those would stand.

    Attributes:
        n_train: Size of the training set behind the surrogate.
        theta_screened: Shape (p,). [parameter units]
        theta_polished: Shape (p,). [parameter units]
        mse_surrogate: MSE by the surrogate at the screened point. [output unit squared]
        mse_screened: MSE by the physical model at the screened point; inf if it failed there.
        mse_polished: MSE by the physical model at the polished point.
        y_screened: The physical model at the screened point; NaN if it failed. Shape (t, k).
        y_polished: The physical model at the polished point. Shape (t, k).
        history_calls: Model calls so far, all those before the polish included, ascending. Shape (h,).
        history_mse: Best MSE after that many calls. Shape (h,).
        n_validation: Simulations of the validation set.
        n_test: Simulations of the test set.
        n_screen_checks: Calls of the physical model at the screened point.
        n_polish: Calls during the polish, finite differences included.
        wall_s: Wall time of screening and polishing. [s]
        test_mae: MAE of the surrogate on the test set; NaN if unknown. [output unit, differences]
        test_p90: 90th percentile of the row-wise MAE on the test set; NaN if unknown.
        stop_reason: Why the calibration ended, in words.
        method: How it was calibrated.
        n_adaptive: Calls of an adaptive calibration.
        n_known: Stored simulations that it began with, which are none of its calls.
        knowledge: What was known of each parameter; empty where nothing was.
        state_equations: What became of state equations, in a sentence; empty where none were looked for.
        left_open: What the data do not determine, in sentences; empty where nothing is known of that.
    """

    n_train: int
    theta_screened: Floats
    theta_polished: Floats
    mse_surrogate: float
    mse_screened: float
    mse_polished: float
    y_screened: Floats
    y_polished: Floats
    history_calls: Integers
    history_mse: Floats
    n_validation: int
    n_test: int
    n_screen_checks: int
    n_polish: int
    wall_s: float
    test_mae: float = float("nan")
    test_p90: float = float("nan")
    stop_reason: str = ""
    method: Method = "paper"
    n_adaptive: int = 0
    n_known: int = 0
    knowledge: tuple[str, ...] = ()
    state_equations: str = ""
    left_open: tuple[str, ...] = ()

    @property
    def is_adaptive(self) -> bool:
        """Whether there is no surrogate and no screened point."""
        return self.method == "adaptive"

    @property
    def name(self) -> str:
        """What files and anchors of this calibration are called."""
        return "adaptive" if self.is_adaptive else f"n{self.n_train:04d}"

    @property
    def shown_name(self) -> str:
        """What readers call it."""
        return "adaptive" if self.is_adaptive else f"n = {self.n_train}"

    @property
    def final(self) -> str:
        """What its last point is called."""
        return "calibrated" if self.is_adaptive else "polished"

    @property
    def calls_to_polish(self) -> int:
        """Model calls before the polish began."""
        return self.n_train + self.n_screen_checks

    @property
    def screening_gap(self) -> float:
        """MSE of the physical model minus MSE of the surrogate, both at the screened point."""
        return self.mse_screened - self.mse_surrogate

    @property
    def calls_paper(self) -> int:
        """Model calls as the paper counts them: all that found the parameters."""
        return self._ledger.total_paper

    @property
    def total_calls(self) -> int:
        """Every simulation that was asked of the physical model, validation and test sets included."""
        return self._ledger.total_calls

    @property
    def _ledger(self) -> Ledger:
        return Ledger(**{one.name: getattr(self, one.name) for one in fields(Ledger)})

    def calls_to(self, target: float) -> int | None:
        """Return the model calls (as the paper counts) until the best MSE was at most `target`, or None."""
        reached = np.flatnonzero(self.history_mse <= target)
        return int(self.history_calls[reached[0]]) if reached.size else None


@dataclass(frozen=True)
class CoverageSet:
    """A simulated set of trajectories, to see whether it covers the measurement.

    Attributes:
        name: What the set is, e.g. "training".
        y: Failed rows are NaN throughout. Shape (n, t, k). [output units]
    """

    name: str
    y: Floats

    @property
    def good(self) -> Floats:
        """The trajectories of the rows that did not fail. Shape (n_good, t, k)."""
        return self.y[np.isfinite(self.y).all(axis=(1, 2))]
