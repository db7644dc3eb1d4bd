"""Trajectory sensitivities: derivatives of an FMU's outputs with respect to its parameters.

They come from the FMU's directional derivatives in model exchange. A model that is run by co-simulation gets
them too where its FMU has both interfaces; each row is then held against its co-simulation, and fails where
the two differ.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.fmi.plan import RunPlan
from simulation.fmi.restart import RestartingRunner, Way
from simulation.fmi.sensitivity_solver import SensitivitySolver, StartStates, open_exchange, size_of
from simulation.trajectories import Trajectories

# Relative step of the one difference that the FMU's derivatives are held against.
_CHECK_STEP: Final = 1e-3
# Greatest difference between the interfaces, as a share of an output's range.
_AGREEMENT: Final = 0.005


def why_no_sensitivities(description: FmuDescription, plan: RunPlan) -> str:
    """Say what an FMU lacks for trajectory sensitivities.

    Args:
        description: What the FMU says of itself.
        plan: What is set, stepped through and read.

    Returns:
        One clause; "" when it lacks nothing.
    """
    said = description.interfaces.get("model-exchange")
    if said is None:
        return "it has no model-exchange interface"
    if not said.provides_directional_derivatives:
        return "it provides no directional derivatives"
    if said.can_be_instantiated_only_once_per_process:
        return "it allows one instance per process"
    if description.n_event_indicators:
        return "it has state events"
    if not description.states:
        return "it has no continuous states"
    for variable in plan.calibrated:
        if variable.kind not in ("Real", "Float64"):
            return f"{variable.name} is no Float64"
    for variable in plan.outputs:
        # The standard has derivatives of outputs only.
        if variable.causality != "output":
            return f"{variable.name} is no declared output"
    return ""


class TrajectorySensitivities:
    """Answers rows with outputs and their derivatives."""

    def __init__(
        self, description: FmuDescription, plan: RunPlan, folder: Path, *, shared_warmup: bool
    ) -> None:
        """Open the FMU twice: for trajectories, and for initializations with shifted parameters.

        Args:
            description: What the FMU says of itself.
            plan: What is set, stepped through and read.
            folder: Where the FMU is unpacked.
            shared_warmup: Whether rows share a warm-up, which they must not.

        Raises:
            InputError: If the FMU does not provide them.
        """
        lack = "its rows share a warm-up" if shared_warmup else why_no_sensitivities(description, plan)
        if lack:
            raise InputError(
                f"{description.path}: gives no trajectory sensitivities ({lack}); use finite differences"
            )
        self._plan = plan
        self._where = str(description.path)
        self._checked = False
        ways: tuple[Way, ...] = ("reset",)
        if description.interface("model-exchange", "").can_get_and_set_state:
            ways = ("reset", "state")
        parts = open_exchange(description, plan, folder)
        self._start_states = RestartingRunner(parts[0], StartStates(*parts), ways=ways, answers_differ=False)
        try:
            parts = open_exchange(description, plan, folder)
        except BaseException:
            self._start_states.close()
            raise
        self._exchange_tolerance = parts[1].tolerance
        self._trajectories = RestartingRunner(
            parts[0], SensitivitySolver(*parts, self._start_states), ways=ways
        )

    def differentiate(
        self,
        answer: Trajectories,
        values: FloatArray,
        *,
        output_factors: FloatArray | None,
        output_offsets: FloatArray,
        parameter_factors: FloatArray | None,
        simulate: Callable[[FloatArray, FloatArray], str],
    ) -> tuple[Trajectories, FloatArray]:
        """Differentiate simulated rows.

        Args:
            answer: What the model answered; rows that failed are passed over. y of shape (n, t, k).
            values: Its parameters. Shape (n, p). [FMU's units]
            output_factors: From the FMU's to the declared units of the outputs, None for 1. Shape (k,).
            output_offsets: Added to the outputs after that. Shape (k,). [declared units]
            parameter_factors: From the declared to the FMU's units of the parameters, None for 1. Shape (p,).
            simulate: Answers a row, as Runner.run does; asked twice, to check the FMU's derivatives once.

        Returns:
            The answer, with further rows failed where there are no derivatives or the interfaces disagree;
            and the derivatives, NaN in failed rows. Shape (n, t, k, p). [declared units]

        Raises:
            InputError: If the FMU's directional derivatives contradict finite differences.
            NeedsFreshProcess: If a row can only be answered by another process.
        """
        n, t, k = answer.y.shape
        by_output = np.ones(k) if output_factors is None else output_factors
        by_parameter = np.ones(len(self._plan.calibrated)) if parameter_factors is None else parameter_factors
        slopes = np.full((n, t, k, len(self._plan.calibrated)), np.nan)
        failures = list(answer.failures)
        for i in np.flatnonzero(~answer.failed):
            failures[i], y, row = self._row(values[i])
            if failures[i]:
                continue
            if not self._checked:
                self._check(values[i], row, simulate)
            exchanged = y[self._plan.n_warmup :] * by_output + output_offsets
            failures[i] = self._disagreement(answer.y[i], exchanged)
            if not failures[i]:
                slopes[i] = row[self._plan.n_warmup :] * by_output[:, None] * by_parameter
        checked = Trajectories.checked(
            answer.theta,
            answer.y,
            time=answer.time,
            parameter_names=answer.parameter_names,
            output_names=answer.output_names,
            failures=failures,
        )
        return checked, slopes

    def _row(self, values: FloatArray) -> tuple[str, FloatArray, FloatArray]:
        """Say why a row failed; outputs, shape (n_warmup + t, k), and slopes, shape (n_warmup + t, k, p)."""
        n, k, p = self._plan.n_simulated, len(self._plan.outputs), len(values)
        both = np.full(n * k * (1 + p), np.nan)
        reason = self._trajectories.run(values, both)
        return reason, both[: n * k].reshape(n, k), both[n * k :].reshape(n, k, p)

    def _check(
        self, values: FloatArray, slopes: FloatArray, simulate: Callable[[FloatArray, FloatArray], str]
    ) -> None:
        """Hold a row's slopes along one direction against a central difference."""
        shift = _CHECK_STEP * size_of(values) * (-1.0) ** np.arange(len(values))
        after, before = np.empty(slopes.shape[:2]), np.empty(slopes.shape[:2])
        if simulate(values + shift, after) or simulate(values - shift, before):
            return
        self._checked = True
        expected, given = 0.5 * (after - before), slopes @ shift
        noise = 10.0 * self._exchange_tolerance * np.abs(after).max(axis=0)
        apart = np.abs(expected - given).max(axis=0)
        wrong = apart > 0.1 * np.abs(expected).max(axis=0) + noise
        if wrong.any():
            name = self._plan.outputs[int(np.argmax(wrong))].name
            raise InputError(
                f"{self._where}: its directional derivatives contradict finite differences of {name}; "
                "use finite differences"
            )

    def _disagreement(self, y: FloatArray, exchanged: FloatArray) -> str:
        """Say where outputs of the model and of model exchange are too far apart. Both of shape (t, k)."""
        scale = np.maximum(np.ptp(y, axis=0), 1e-3 * np.abs(y).max(axis=0))
        apart = np.abs(y - exchanged).max(axis=0)
        wrong = apart > _AGREEMENT * scale
        if not wrong.any():
            return ""
        column = int(np.argmax(wrong))
        return (
            f"model exchange differs from co-simulation by {apart[column]:.3g} in "
            f"{self._plan.outputs[column].name}; there are no sensitivities of the latter"
        )

    def close(self) -> None:
        """Free the FMU; closing twice does no harm."""
        self._start_states.close()
        self._trajectories.close()
