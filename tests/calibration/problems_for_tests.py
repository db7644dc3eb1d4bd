"""Small calibration problems whose answers are known, and a model that keeps a diary."""

from dataclasses import dataclass, field, replace

import numpy as np
from toy_rc import ToyRC
from toys_for_tests import ProductToy

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem

TRUE_RC = np.array([1.7, 2.3e4])


class Diary(WrappedModel):
    """A model that notes every row it is asked."""

    def __init__(self, model: ForwardModel) -> None:
        super().__init__(model)
        self.batches: list[FloatArray] = []

    @property
    def rows(self) -> FloatArray:
        return np.concatenate(self.batches)

    def simulate(self, theta: FloatArray) -> Trajectories:
        self.batches.append(np.array(theta))
        return self._model.simulate(theta)


class FailsInBand(WrappedModel):
    """A model whose first parameter must not lie in a band."""

    def __init__(self, model: ForwardModel, lower: float, upper: float) -> None:
        super().__init__(model)
        self._lower, self._upper = lower, upper
        self.n_failed = 0

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = self._model.simulate(theta)
        bad = (theta[:, 0] >= self._lower) & (theta[:, 0] <= self._upper)
        self.n_failed += int(bad.sum())
        y = np.where(bad[:, None, None], np.nan, answer.y)
        return replace(answer, y=y, failures=tuple("in the band" if b else "" for b in bad))


@dataclass(frozen=True)
class Waves:
    """A decaying oscillation of unknown frequency: its error has many valleys."""

    parameter_space: ParameterSpace = field(
        default_factory=lambda: ParameterSpace((Parameter("frequency", 0.25, 4.0, scale="log"),))
    )
    output_names: tuple[str, ...] = ("deflection",)
    time: FloatArray = field(default_factory=lambda: np.linspace(0.0, 10.0, 240))

    def simulate(self, theta: FloatArray) -> Trajectories:
        y = np.sin(2.0 * np.pi * theta[:, :1] * self.time) * np.exp(-self.time / 4.0)
        return Trajectories.checked(
            theta,
            y[:, :, None],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


def problem_on(
    model: ForwardModel, truth: FloatArray, *, noise: float = 0.0, uncertainty: FloatArray | None = None
) -> CalibrationProblem:
    """Pose the problem of finding `truth` again."""
    y = model.simulate(truth[None]).y[0]
    y = y + noise * np.random.default_rng(7).normal(size=y.shape)
    k = len(model.output_names)
    measurement = Measurement.on_grid(
        time=np.asarray(model.time),
        y=y,
        output_names=tuple(model.output_names),
        uncertainty=np.full(k, 0.5) if uncertainty is None else uncertainty,
    )
    return CalibrationProblem(model, measurement)


def rc_problem(*, noise: float = 0.0) -> CalibrationProblem:
    """R and C of a step response: both can be found."""
    return problem_on(ToyRC(), TRUE_RC, noise=noise)


def product_problem() -> CalibrationProblem:
    """R and C of a free decay: only their product can be found."""
    return problem_on(ProductToy(), TRUE_RC)
