"""Adaptive calibration: every simulation goes where a surrogate of all earlier ones expects the optimum.

A few rows fill the box; from then on each round fits Gaussian processes to the residuals of all rows, walks
downhill on the error that they expect inside a trust region around the best row, and simulates that point. No
row is spent on differences, validation or a test: the processes are their own Jacobian and their own check.
Where the rows explain too little, a truncated window is fitted first (truncated_window.py).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import BoolArray, FloatArray
from simulation.counting import BudgetExceeded
from simulation.errors import InputError
from studies.calibration.adaptive_search import AdaptiveSearch
from studies.calibration.ending import Ending
from studies.calibration.learned_ode import LearnedODE
from studies.calibration.misfit_threshold import misfit_threshold
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import History, OnProgress, Recorder


@dataclass(frozen=True)
class AdaptiveResult:
    """The best point that an adaptive calibration has seen.

    Attributes:
        u: In the unit cube. Shape (p,). [1]
        theta: As parameters. Shape (p,). [per parameter]
        y: Trajectory there. Shape (t, k). [output's unit]
        mse: Mean squared error there, infinite when no simulation succeeded. [first output's unit squared]
        objective: The same with a prior's penalty. [first output's unit squared]
        n_calls: Rows asked of the model.
        n_rounds: What it takes with as many parallel workers as rows are asked for in a round.
        expected_gain: Part of the error that the surrogate last expected to gain. [1]
        history: Best MSE over rows asked.
        stop_reason: Why it ended, in words.
        converged: True when the target ended it, or little was expected and tests of that found nothing;
            False for a budget, failures, a gain that may be left, or an error that is too large.
        left: Where it did not converge, what may be left to gain and what the next round would try.
        is_flat: Parameters on which the error around the best point hardly depends over all of their ranges,
            as far as rows or state equations show. Shape (p,).
        slopes: Slopes of the residuals there, in an orthonormal basis of p residuals, as rows or state
            equations show; None where these are too few. Shape (p, p). [first output's unit per range]
    """

    u: FloatArray
    theta: FloatArray
    y: FloatArray
    mse: float
    objective: float
    n_calls: int
    n_rounds: int
    expected_gain: float
    history: History
    stop_reason: str
    converged: bool
    left: str
    is_flat: BoolArray
    slopes: FloatArray | None


@dataclass(frozen=True)
class Adaptive:
    """Calibration by Gaussian processes of the residuals in a trust region.

    Attributes:
        n_start: Rows of the first, space-filling design; as many as parameters when None, at least 4. [1]
        margin: Part of each coordinate's range that the first design leaves out at both ends. [1]
        caution: Part of the predictive variance that counts as error: 0 trusts the surrogate's mean. [1]
        radius: First half width of the trust region in the unit cube. [1]
        least_radius: Half width below which a bad step no longer shrinks it, only failures do. [1]
        n_descents: Descents on the surrogate per round, the first from the best row. [1]
        n_parallel: Rows asked per round.
        ftol: Where the surrogate expects less than this relative gain, a search phase ends; the search ends
            once tests of that, all over the box, have found nothing. [1]
        patience: Rounds without expectation or gain before a phase away from the best row ends. [1]
        stall_rounds: Rounds within which a phase must gain `stall_gain`, or it ends too. [1]
        stall_gain: The relative gain that a phase owes. [1]
        least_restarts: Least number of restarts away from the best row, for problems with several valleys,
            before a search may converge; 0 never leaves the first valley. [1]
        misfit_threshold: Error above which a valley is no answer: the search restarts until its surrogate
            excludes half the error everywhere, or stops, without converging, once restarts and tests promise
            no gain; None accepts every valley. [first output's unit squared]
        target_mse: Go on to this error or the end of the budget, however little is expected; or None. [first
            output's unit squared]
        max_calls: Most rows that may be asked of the model.
    """

    n_start: int | None = None
    margin: float = 0.15
    caution: float = 0.1
    # A wider first trust region gained nothing (docs/notes/adaptive-search.md, First form).
    radius: float = 0.3
    least_radius: float = 0.05
    n_descents: int = 3
    n_parallel: int = 1
    ftol: float = 1e-3
    patience: int = 3
    stall_rounds: int = 10
    stall_gain: float = 0.02
    least_restarts: int = 1
    misfit_threshold: float | None = None
    target_mse: float | None = None
    max_calls: int = 200

    def __post_init__(self) -> None:
        """Refuse settings that no search can run with."""
        counts = {"max_calls": 1, "n_descents": 1, "n_parallel": 1, "patience": 1, "stall_rounds": 1}
        for name, least in (counts | {"least_restarts": 0, "n_start": 2}).items():
            value = getattr(self, name)
            if value is None and name == "n_start":
                continue
            if not isinstance(value, int | np.integer) or value < least:
                raise InputError(
                    f"adaptive calibration: {name} is {value}; give a whole number of at least {least}"
                )
        for name in ("ftol", "stall_gain", "target_mse", "misfit_threshold"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise InputError(f"adaptive calibration: {name} is {value}; give at least 0")
        if not 0.0 <= self.margin < 0.5:
            raise InputError(f"adaptive calibration: margin is {self.margin}; give a value in [0, 0.5)")
        if not self.caution >= 0.0:
            raise InputError(f"adaptive calibration: caution is {self.caution}; give at least 0")
        if not 0.0 < self.least_radius <= self.radius <= 1.0:
            raise InputError(
                f"adaptive calibration: least_radius is {self.least_radius} and radius {self.radius}; "
                "give 0 < least_radius <= radius <= 1"
            )

    @classmethod
    def for_sensor(
        cls, sensor: float, *, max_calls: int, n_parallel: int = 1, target_mse: float | None = None
    ) -> Self:
        """Return the settings of `studies calibrate`.

        Args:
            sensor: Uncertainty of the first output's sensor, infinite where it is not known. [first output's
                unit]
            max_calls: Most rows that may be asked of the model.
            n_parallel: Rows asked per round.
            target_mse: Error to stop at, or None. [first output's unit squared]
        """
        return cls(
            max_calls=max_calls,
            n_parallel=n_parallel,
            # Where every output is off by its own sensor's uncertainty, the MSE is the first one's squared.
            misfit_threshold=misfit_threshold(sensor),
            target_mse=target_mse,
        )

    def design_size(self, n_parameters: int) -> int:
        """Return the rows of the first design."""
        # 10, 12 or 18 rows at the start instead of 14 gained
        # nothing (docs/notes/adaptive-search.md, First form).
        return self.n_start or max(n_parameters, 4)

    def minimize(
        self,
        problem: CalibrationProblem,
        *,
        seed: int,
        known: Evaluation | None = None,
        learned_ode: LearnedODE | None = None,
        on_progress: OnProgress | None = None,
    ) -> AdaptiveResult:
        """Calibrate without an initial guess.

        The rows follow from problem, settings, warm start and seed alone: repeated over stored simulations, a
        calibration goes on where it stopped.

        Args:
            problem: The problem, posed to the physical model.
            seed: Seed of the first design and all draws.
            known: Rows of this problem that were simulated before; they cost nothing and are the first design
                as far as they fill it.
            learned_ode: Learns the model's state equations from rows and proposes others, None for none.
            on_progress: Called after each round.

        Returns:
            The best point seen; never raises for a failed simulation or a spent budget.

        Raises:
            InputError: If it is given something else than a problem, or rows of another one.
        """
        if not isinstance(problem, CalibrationProblem):
            raise InputError(
                f"a calibration needs CalibrationProblem(model, measurement), not {type(problem).__name__}"
            )
        shape = (problem.measurement.n_samples, problem.space.n_parameters)
        if known is not None and (
            not isinstance(known, Evaluation) or (known.residuals.shape[1], known.u.shape[1]) != shape
        ):
            raise InputError(
                "a warm start is what problem.evaluate(u) or problem.judge(u, trajectories) returns, of the "
                f"same problem: {shape[1]} parameters and {shape[0]} residuals"
            )
        recorder = Recorder(problem, phase="adaptive", max_calls=self.max_calls, on_progress=on_progress)
        search = AdaptiveSearch(self, problem, recorder, np.random.default_rng(seed), known, learned_ode)
        try:
            # Threads that share matrices of a hundred rows wait for each other: 11 s with two, 2 s with one.
            with threadpool_limits(limits=1, user_api="blas"):
                ending = search.run()
        except BudgetExceeded as end:
            missed = "" if self.target_mse is None else f"; the target of {self.target_mse:g} is missed"
            ending = Ending(f"{end}{missed}", converged=False)
        reason = ending.reason
        best = recorder.best
        assert best is not None, "a budget of at least one row lets the first design be asked"
        if best.failures[0]:
            reason = f"no simulation succeeded, the first one: {best.failures[0]}; {reason}"
        return AdaptiveResult(
            u=best.u[0],
            theta=best.theta[0],
            y=best.y[0],
            mse=float(best.mse[0]),
            objective=float(best.objective[0]),
            n_calls=recorder.n_calls,
            n_rounds=search.n_rounds,
            expected_gain=search.expected_gain,
            history=recorder.history,
            stop_reason=reason,
            converged=ending.converged,
            left="" if ending.converged else search.left,
            is_flat=search.is_flat,
            slopes=search.slopes,
        )
