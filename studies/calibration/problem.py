"""The calibration problem: a model, a measurement, and the residuals between them in the unit cube."""

from dataclasses import dataclass, fields, replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.layout import Layout
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.prior import Prior


@dataclass(frozen=True)
class Evaluation:
    """What a model answered at n points of the unit cube.

    Attributes:
        u: Points. Shape (n, p). [1]
        theta: The same points as parameters. Shape (n, p). [per parameter]
        y: Trajectories, NaN in failed rows. Shape (n, t, k). [output's unit]
        residuals: Scaled (simulated - measured) at the m samples of all outputs, as the outputs' losses count
            them, NaN in failed rows. Shape (n, m). [first output's unit]
        mse: Mean of the squared residuals, which is the mean loss where an output has a robust loss; infinite
            in failed rows. Shape (n,). [first output's unit squared]
        objective: What is minimized: this error, and a prior's penalty where there is one. Shape (n,). [same]
        failures: Why a row failed; "" where it did not. Length n.
    """

    u: FloatArray
    theta: FloatArray
    y: FloatArray
    residuals: FloatArray
    mse: FloatArray
    objective: FloatArray
    failures: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.u)

    def take(self, index: int) -> "Evaluation":
        """Return one row as an evaluation of its own."""
        return Evaluation(*(getattr(self, one.name)[index : index + 1] for one in fields(self)))

    def joined(self, other: "Evaluation") -> "Evaluation":
        """Return these rows and others of the same problem behind them."""
        parts = {one.name: (getattr(self, one.name), getattr(other, one.name)) for one in fields(self)}
        failures = (*self.failures, *other.failures)
        arrays = {name: np.concatenate(pair) for name, pair in parts.items() if name != "failures"}
        return Evaluation(**arrays, failures=failures)


@dataclass(frozen=True)
class CalibrationProblem:
    """Find the parameters with which a model reproduces a measurement.

    The same problem is posed to the surrogate (screening) and to the physical model (polishing): see `on`.
    The measurement says how outputs are compared and weighted; the MSE is in the first output's unit squared.

    Attributes:
        model: The model that is asked.
        measurement: The target, on the model's output grid.
        prior: What is known about the parameters beforehand, or None.
        layout: Which parameters act in which experiment, and on which outputs; None for one experiment.
    """

    model: ForwardModel
    measurement: Measurement
    prior: Prior | None = None
    layout: Layout | None = None

    def __post_init__(self) -> None:
        """Refuse what is no model, and a measurement that it cannot be compared with."""
        for name in ("parameter_space", "output_names", "time", "simulate"):
            if not hasattr(self.model, name):
                raise InputError(f"a model needs {name}, and {type(self.model).__name__} has none")
        if tuple(self.model.output_names) != tuple(self.measurement.output_names):
            raise InputError(
                f"the model's outputs {tuple(self.model.output_names)} are not the measured ones "
                f"{tuple(self.measurement.output_names)}; declare the same outputs in the same order"
            )
        time, measured = np.asarray(self.model.time), np.asarray(self.measurement.time)
        if time.shape != measured.shape or not np.allclose(time, measured, rtol=0.0, atol=1e-6):
            raise InputError(
                f"the model answers at {time.size} times up to {time[-1]:g} s, the measurement has "
                f"{measured.size} up to {measured[-1]:g} s; open both from the same case and window"
            )
        if self.prior is not None and self.prior.width.size != self.space.n_parameters:
            raise ValueError(
                f"the prior is of {self.prior.width.size} parameters, the model has {self.space.n_parameters}"
            )

    @property
    def space(self) -> ParameterSpace:
        """The parameters, their bounds and coordinates."""
        return self.model.parameter_space

    @property
    def n_acting(self) -> int:
        """Parameters of the experiment that has most."""
        experiments = () if self.layout is None else self.layout.experiments
        return max((one.parameters.size for one in experiments), default=self.space.n_parameters)

    def on(self, model: ForwardModel) -> "CalibrationProblem":
        """Pose the same problem to another model of the same parameters."""
        mine, theirs = self.space, model.parameter_space
        same = (
            mine.names == theirs.names
            and np.array_equal(mine.lower, theirs.lower)
            and np.array_equal(mine.upper, theirs.upper)
            and np.array_equal(mine.is_log, theirs.is_log)
            and (mine.constraints, mine.sums) == (theirs.constraints, theirs.sums)
        )
        if not same:
            raise InputError(
                "the two models do not share parameters, bounds and scales; "
                "train the surrogate on the case that is calibrated"
            )
        return replace(self, model=model)

    def evaluate(self, u: FloatArray) -> Evaluation:
        """Ask the model at points of the unit cube.

        Args:
            u: Points; a single one may come flat. Shape (n, p) or (p,). [1]

        Returns:
            Everything known about them, in the same order.
        """
        u = np.atleast_2d(np.asarray(u, dtype=np.float64))
        theta = np.asarray(self.space.from_unit(u), dtype=np.float64)
        return self.judge(u, self.model.simulate(theta))

    def judge(self, u: FloatArray, trajectories: Trajectories) -> Evaluation:
        """Compare trajectories that exist already with the measurement.

        Args:
            u: The points they belong to. Shape (n, p). [1]
            trajectories: The model's answers, in the same order.
        """
        residuals = self.measurement.compared(trajectories.y)
        failed = trajectories.failed | ~np.all(np.isfinite(residuals), axis=1)
        mse = np.full(len(u), np.inf)
        # What is too large to square counts as failed below.
        with np.errstate(over="ignore"):
            mse[~failed] = np.mean(residuals[~failed] ** 2, axis=1)
        failed |= np.isinf(mse)
        failures = tuple(
            reason or ("the simulated values are not finite, or too large to square" if bad else "")
            for reason, bad in zip(trajectories.failures, failed, strict=True)
        )
        objective = mse
        if self.prior is not None:
            objective = np.where(failed, np.inf, mse + self.prior.penalty(u))
        return Evaluation(u, trajectories.theta, trajectories.y, residuals, mse, objective, failures)

    def residuals(self, u: FloatArray) -> FloatArray:
        """Return the signed residuals, simulated minus measured. Shape (n, m). [first output's unit]."""
        return self.evaluate(u).residuals

    def mse(self, u: FloatArray) -> FloatArray:
        """Return the mean squared error, infinite where a row failed. Shape (n,). [unit squared]."""
        return self.evaluate(u).mse
