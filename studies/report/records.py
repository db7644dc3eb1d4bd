"""What figures and tables draw: frozen records of plain arrays and strings, and nothing that draws.

Every record is filled by the caller from stored results, so that a report can be rebuilt from files alone.
Shapes use t time steps, k outputs, p parameters, n parameter sets, h history entries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulation.measurement import Measurement, Samples
from studies.calibration.ledger import Ledger

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

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (t, k) of a trajectory."""
        return len(self.time), len(self.output_names)

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


@dataclass(frozen=True)
class RestrictionRecord:
    """Which parameters a calibration left out, and what is known of that choice.

    Attributes:
        n_free: Parameters that were calibrated.
        fixed: Names of the others.
        shares: Share of each parameter in what varies, by name; None where it is not known. [1]
        source: What says so: "Sobol" or "Morris".
        n_calls: Calls for that, made first of all.
        n_calls_before: Calls that stored Sobol indices had cost before.
        gain: Part of the error that freeing all others would take away; None where not checked. [1]
        gain_alone: The same for each of them alone, by name; None where its simulation failed, empty where
            not checked. [1]
        n_check: Calls of that check.
    """

    n_free: int
    fixed: tuple[str, ...]
    shares: Mapping[str, float | None]
    source: str
    n_calls: int = 0
    n_calls_before: int = 0
    gain: float | None = None
    gain_alone: Mapping[str, float | None] = field(default_factory=dict)
    n_check: int = 0

    @property
    def closest_call(self) -> tuple[str, str] | None:
        """The least relevant parameter that was calibrated and the most relevant one that was not."""
        known = {name: share for name, share in self.shares.items() if share is not None}
        fixed = [name for name in known if name in self.fixed]
        free = [name for name in known if name not in self.fixed]
        return (
            (min(free, key=known.__getitem__), max(fixed, key=known.__getitem__)) if free and fixed else None
        )


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
        surrogate: Which surrogate it was (trial, alias, folder), in words.
        method: How it was calibrated.
        n_adaptive: Calls of an adaptive calibration.
        n_known: Stored simulations that it began with, which are none of its calls.
        restriction: What was fixed; None where all parameters were calibrated.
        knowledge: What was known of each parameter, or that it was fixed; empty where nothing was.
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
    surrogate: str = ""
    method: Method = "paper"
    n_adaptive: int = 0
    n_known: int = 0
    restriction: RestrictionRecord | None = None
    knowledge: tuple[str, ...] = ()
    state_equations: str = ""
    left_open: tuple[str, ...] = ()

    @property
    def is_adaptive(self) -> bool:
        """Whether there is no surrogate and no screened point."""
        return self.method == "adaptive"

    @property
    def n_free(self) -> int | None:
        """Parameters that were calibrated, the others fixed; None for all."""
        return None if self.restriction is None else self.restriction.n_free

    @property
    def n_before(self) -> int:
        """Calls that found, first of all, which parameters matter."""
        return 0 if self.restriction is None else self.restriction.n_calls

    @property
    def n_relevance(self) -> int:
        """Calls that found, and checked, which parameters matter."""
        return 0 if self.restriction is None else self.restriction.n_calls + self.restriction.n_check

    @property
    def name(self) -> str:
        """What files and anchors of this calibration are called."""
        part = "" if self.n_free is None else f"-relevant{self.n_free}"
        return ("adaptive" if self.is_adaptive else f"n{self.n_train:04d}") + part

    @property
    def shown_name(self) -> str:
        """What readers call it."""
        part = "" if self.n_free is None else f", {self.n_free} most relevant parameters"
        return ("adaptive" if self.is_adaptive else f"n = {self.n_train}") + part

    @property
    def final(self) -> str:
        """What its last point is called."""
        return "calibrated" if self.is_adaptive else "polished"

    @property
    def calls_to_screen(self) -> int:
        """Model calls before the screened point was checked."""
        return self.n_before + self.n_train

    @property
    def calls_to_polish(self) -> int:
        """Model calls before the polish began."""
        return self.calls_to_screen + self.n_screen_checks

    @property
    def screening_gap(self) -> float:
        """MSE of the physical model minus MSE of the surrogate, both at the screened point."""
        return self.mse_screened - self.mse_surrogate

    @property
    def calls_paper(self) -> int:
        """Model calls as the paper counts them: all that found the parameters."""
        return self._ledger.total_paper

    @property
    def calls_honest(self) -> int:
        """Every simulation that was asked of the physical model, validation and test sets included."""
        return self._ledger.total_honest

    @property
    def _ledger(self) -> Ledger:
        return Ledger(**{one.name: getattr(self, one.name) for one in fields(Ledger)})

    def calls_to(self, target: float) -> int | None:
        """Return the model calls (as the paper counts) until the best MSE was at most `target`, or None."""
        reached = np.flatnonzero(self.history_mse <= target)
        return int(self.history_calls[reached[0]]) if reached.size else None


@dataclass(frozen=True)
class CoverageSet:
    """A simulated set of trajectories, to see whether it covers parameters and measurement.

    Attributes:
        name: What the set is, e.g. "training".
        theta: Shape (n, p). [parameter units]
        y: Failed rows are NaN throughout. Shape (n, t, k). [output units]
    """

    name: str
    theta: Floats
    y: Floats
