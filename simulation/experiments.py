"""Several experiments as one model: every row is simulated in each, and its outputs stand side by side."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.fmu import FmuModel, FmuSettings
from simulation.forward_model import ForwardModel
from simulation.layout import Layout
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class ExperimentRows:
    """Rows of any experiment, for one pool of processes: the first column of theta says of which.

    The other columns are the parameters of all experiments; those of others are not looked at.

    Attributes:
        layout: How rows of several experiments become one.
        settings: How each experiment's model is opened.
    """

    layout: Layout
    settings: tuple[FmuSettings, ...]

    @property
    def path(self) -> str:
        """What errors about opening the models are about."""
        return str(self.settings[0].path)

    @property
    def parameter_space(self) -> ParameterSpace:
        """The experiment's place and the parameters; the bounds mean nothing."""
        names = ("experiment", *self.layout.parameter_names)
        return ParameterSpace(tuple(Parameter(name, 0.0, 1.0) for name in names))

    @property
    def output_names(self) -> tuple[str, ...]:
        """Places of the outputs of the experiment with the most."""
        return tuple(str(k) for k in range(max(len(one.outputs) for one in self.layout.experiments)))

    @property
    def time(self) -> FloatArray:
        """Output times of the longest experiment. Shape (t,). [s]."""
        return self.layout.time

    def rows(self, theta: FloatArray, experiment: int) -> FloatArray:
        """Return rows of one experiment. Shapes (n, p) and (n, 1 + p)."""
        return np.column_stack([np.full(len(theta), float(experiment)), theta])

    def answer(self, rows: Trajectories, experiment: int) -> Trajectories:
        """Return what answers say of an experiment, as its own model would.

        Args:
            rows: Answers to rows of this experiment.
            experiment: Its place.
        """
        one, settings = self.layout.experiments[experiment], self.settings[experiment]
        return Trajectories(
            self.layout.theta_of(one, rows.theta[:, 1:]),
            np.ascontiguousarray(rows.y[:, : one.n_times, : len(one.outputs)]),
            settings.scenario.time,
            settings.parameter_space.names,
            settings.output_names,
            rows.failures,
        )

    def prepare(self) -> None:
        """Read what opening the models reads, for forks of this process."""
        for one in self.settings:
            one.prepare()

    def make_ready(self, on_warning: Callable[[str], None]) -> None:
        """Make what opening the models needs once on a machine; see FmuSettings."""
        for one in self.settings:
            one.make_ready(on_warning)

    def open(self) -> "ExperimentsModel":
        """Open the models; the bound method is the factory that worker processes are given."""
        return ExperimentsModel(self)


class ExperimentsModel:
    """The models of several experiments in one process.

    The first of each interface is opened at once, each other one when it is first asked.

    Attributes:
        parameter_space: The experiment's place and the parameters.
        output_names: Places of the outputs.
        time: Output times of the longest experiment. Shape (t,). [s]
    """

    def __init__(self, rows: ExperimentRows) -> None:
        """Open the first model, so that what cannot be opened is said at once.

        Args:
            rows: What may be asked.
        """
        self._rows = rows
        self.parameter_space, self.output_names = rows.parameter_space, rows.output_names
        self.time = rows.time
        self._models: dict[int, FmuModel] = {}
        # One model of each interface: its loop is compiled before a row, whose time may be limited.
        ways = [one.interface for one in rows.settings]
        for place in sorted({ways.index(way) for way in ways}):
            self._model(place)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row in the experiment that it names.

        Args:
            theta: Place of the experiment and parameters. Shape (n, 1 + p).

        Returns:
            The trajectories; what an experiment does not have is 0.
        """
        layout, names = self._rows.layout, self.output_names
        y, reasons = np.zeros((len(theta), len(self.time), len(names))), list[str]()
        for row, (place, *values) in enumerate(theta):
            one = layout.experiments[int(place)]
            answer = self._model(int(place)).simulate(layout.theta_of(one, np.array([values])))
            y[row, : one.n_times, : len(one.outputs)] = answer.y[0]
            reasons += answer.failures
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=names,
            failures=reasons,
        )

    def close(self) -> None:
        """Close the models."""
        for model in self._models.values():
            model.close()

    def _model(self, place: int) -> FmuModel:
        if place not in self._models:
            self._models[place] = self._rows.settings[place].open()
        return self._models[place]


class JoinedModel:
    """Several experiments as one forward model, around a model that answers rows of any experiment.

    Attributes:
        model: Answers rows of `rows`.
        rows: Which rows those are.
        parameter_space: Parameters of all experiments.
        output_names: Names of the outputs of all experiments.
        time: Output times of the longest experiment. Shape (t,). [s]
    """

    def __init__(self, model: ForwardModel, rows: ExperimentRows, space: ParameterSpace) -> None:
        """Wrap a model.

        Args:
            model: Answers rows of `ExperimentRows`, a pool for instance.
            rows: Which rows those are.
            space: Parameters of all experiments.
        """
        self.model, self.rows = model, rows
        self.parameter_space = space
        self.output_names, self.time = rows.layout.output_names, rows.layout.time

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row in every experiment, side by side.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
        """
        places = range(len(self.rows.layout.experiments))
        answer = self.model.simulate(np.concatenate([self.rows.rows(theta, place) for place in places]))
        n = len(theta)
        parts = [
            self.rows.answer(answer.take(np.arange(place * n, (place + 1) * n)), place) for place in places
        ]
        return self.rows.layout.join(theta, parts)

    def simulate_alone(self, theta: FloatArray, place: int) -> Trajectories:
        """Simulate every row in one experiment, as its own model would.

        Args:
            theta: Parameters of all experiments. Shape (n, p). [per parameter]
            place: Which experiment.
        """
        return self.rows.answer(self.model.simulate(self.rows.rows(theta, place)), place)
