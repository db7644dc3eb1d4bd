"""Adaptive calibration: every simulation goes where a surrogate of all earlier ones expects the optimum.

A few points fill the bounds; from then on each round fits Gaussian processes to all residuals, walks
downhill on the error that they expect inside a trust region around the best row, and simulates that point. No
row is spent on differences, validation or a test: the processes are their own Jacobian and their own check.
Where the rows explain too little, a truncated window is fitted first (truncated_window.py).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from threadpoolctl import threadpool_limits

from pelsvae.linear_network.drive import Drive
from simulation.arrays import BoolArray, FloatArray
from simulation.counting import BudgetExceeded
from simulation.errors import InputError
from studies.calibration.corrected_surrogate import CorrectedSurrogate
from studies.calibration.hidden_network.search import HiddenNetwork
from studies.calibration.leader import Leader
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.proposer import Proposer
from studies.calibration.recorder import OnProgress, Recorder, SearchResult
from studies.calibration.search.adaptive_search import run
from studies.calibration.search.ending import Ending, left
from studies.calibration.search.local_shape import local_shape
from studies.calibration.search.misfit_threshold import misfit_threshold
from studies.calibration.search.search_state import SearchState
from studies.calibration.search.settings import SearchSettings


@dataclass(frozen=True)
class AdaptiveResult(SearchResult):
    """The best point that an adaptive calibration has seen.

    It has converged where the target ended it, or little was expected and tests of that found nothing; not
    after a budget, failures, a gain that may be left, or an error that is too large.

    Attributes:
        n_rounds: What it takes with as many parallel workers as rows are asked for in a round.
        expected_gain: Part of the error that the surrogate last expected to gain. [1]
        left: Where it did not converge, what may be left to gain and what the next round would try.
        is_flat: Parameters on which the error around the best point hardly depends over all of their ranges,
            as far as rows or state equations show. Shape (p,).
        slopes: Slopes of the residuals there, in an orthonormal basis of p residuals, as rows or state
            equations show; None where these are too few. Shape (p, p). [first output's unit per range]
    """

    n_rounds: int
    expected_gain: float
    left: str
    is_flat: BoolArray
    slopes: FloatArray | None


@dataclass(frozen=True)
class Adaptive(SearchSettings):
    """Calibration by Gaussian processes of the residuals in a trust region."""

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

    def minimize(
        self,
        problem: CalibrationProblem,
        *,
        seed: int,
        known: Evaluation | None = None,
        learned_ode: Proposer | None = None,
        network_inputs: Drive | None = None,
        surrogate: CalibrationProblem | None = None,
        u0: FloatArray | None = None,
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
            network_inputs: What drives the model, where it may be a network that hides its states; None
                otherwise.
            surrogate: The problem, posed to a surrogate that was trained before, which leads the search; None
                for none.
            u0: A point to ask before all others, clipped into the unit cube; None for none. Shape (p,). [1]
            on_progress: Called after each round, and before what may take seconds.

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
        leaders: list[Leader] = [] if surrogate is None else [CorrectedSurrogate(surrogate, seed)]
        leaders += [] if network_inputs is None else [HiddenNetwork(network_inputs, problem, seed)]
        rng = np.random.default_rng(seed)
        state = SearchState(self, recorder, rng, known, learned_ode, leaders)
        try:
            # Threads that share matrices of a hundred rows wait for each other: 11 s with two, 2 s with one.
            # What overflows counts as failed, and is no news to who calibrates.
            with threadpool_limits(limits=1, user_api="blas"), np.errstate(all="ignore"):
                if u0 is not None:
                    state.ask(np.clip(u0, 0.0, 1.0)[None])
                ending = run(state)
        except BudgetExceeded as end:
            missed = "" if self.target_mse is None else f"; the target of {self.target_mse:g} is missed"
            ending = Ending(f"{end}{missed}", converged=False)
        reason = ending.reason
        best = recorder.best
        if best is not None and best.failures[0]:
            reason = f"no simulation succeeded, the first one: {best.failures[0]}; {reason}"
        with np.errstate(all="ignore"):
            is_flat, slopes = local_shape(state)
            return recorder.result(
                AdaptiveResult,
                reason,
                converged=ending.converged,
                n_rounds=state.n_rounds,
                expected_gain=state.expected_gain,
                left="" if ending.converged else left(state),
                is_flat=is_flat,
                slopes=slopes,
            )
