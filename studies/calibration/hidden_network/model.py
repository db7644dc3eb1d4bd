"""A network of capacities and conductances that no output shows, as a function of the parameters.

Every capacity, conductance and gain is a constant times powers of the parameters. States at the start are
sums of parameters in the outputs' unit. The powers and constants are unknown: fit.py finds them.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from pelsvae.linear_network.drive import Drive
from pelsvae.linear_network.form import CAPACITIES, CONDUCTANCE, COUPLING, MOST_LOG, SPREAD, START
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.parameters import ParameterSpace
from studies.calibration.hidden_network.steps import steps

# States beside the outputs. Three or four for one output fitted offices alike (docs/notes/adaptive-search.md,
# A hidden network).
N_HIDDEN = 3
# Standard deviations of a power, and of the factors of a state at the start.
POWER, FACTOR = 0.5, 1.0


@dataclass(frozen=True, eq=False)
class NetworkForm:
    """Which capacities, conductances and gains there are, and what is known of their powers beforehand.

    Attributes:
        inputs: What drives the network.
        places: Of every coupling, as `steps.steps` takes them. Shape (e, 4).
        makes: Which of the q elements make a coupling: conductance or gain 1, capacity -1. Shape (e, q).
        n_outputs: Outputs, the first states.
        is_free: Which powers and factors there are, of the q elements and s starts. Shape (q + s, 1 + p).
        mean: The most probable ones beforehand, constants in the first column. Shape (q + s, 1 + p).
        precision: Inverse variances. Shape (q + s, 1 + p).
        by_unit: What the powers of an element are multiplied by, for their sum; zero without units. Shape
            (1 + p,).
        powers: The sums that units demand. Shape (q,).
        space: The parameters.
    """

    inputs: Drive
    places: IntArray
    makes: FloatArray
    n_outputs: int
    is_free: BoolArray
    mean: FloatArray
    precision: FloatArray
    by_unit: FloatArray
    powers: FloatArray
    space: ParameterSpace

    @classmethod
    def of(cls, inputs: Drive, space: ParameterSpace, n_outputs: int) -> Self:
        """Return the form of a problem's network: every element that may be there.

        Args:
            inputs: What drives it.
            space: The parameters.
            n_outputs: Outputs.
        """
        s, p = n_outputs + N_HIDDEN, space.n_parameters
        # Capacities are the first elements.
        kinds, powers = [CAPACITIES[min(i, len(CAPACITIES) - 1)] for i in range(s)], [0.0] * s
        places, pairs = list[tuple[int, int, int, int]](), list[tuple[int, int]]()

        def add(mean: float, power: float, *moves: tuple[int, int, int, int]) -> None:
            for place in moves:
                places.append(place)
                pairs.append((len(kinds), place[1]))
            kinds.append(mean)
            powers.append(power)

        for i in range(s):
            for j in range(i + 1, s):
                # What flows between two states moves both.
                add(CONDUCTANCE, -1.0, (0, i, j, -1), (0, j, i, -1))
            for j in range(inputs.potentials.shape[1]):
                for switch in range(-1, inputs.patterns.shape[1]):
                    add(COUPLING, -1.0, (1, i, j, switch))
            for j, powers_of_time in enumerate(inputs.source_powers, inputs.potentials.shape[1]):
                # A heat flow in W has -3 powers of time: those of an input and its gain together.
                add(COUPLING, -3.0 - powers_of_time, (2, i, j, -1))
        q = len(kinds)
        makes = np.zeros((len(places), q))
        for row, (element, state) in enumerate(pairs):
            makes[row, element], makes[row, state] = 1.0, -1.0
        mean, deviation = np.zeros((q + s, 1 + p)), np.full((q + s, 1 + p), POWER)
        mean[:q, 0], deviation[:q, 0] = kinds, SPREAD
        deviation[q:, 0], deviation[q:, 1:] = START, FACTOR
        is_free = np.ones((q + s, 1 + p), dtype=np.bool_)
        is_free[:q, 1:], is_free[q:, 1:] = ~inputs.is_start, inputs.is_start
        by_unit = np.zeros(1 + p)
        if inputs.time_powers.size:
            by_unit[1:] = np.where(inputs.is_start, 0.0, inputs.time_powers)
        return cls(
            inputs,
            np.array(places, dtype=np.int64),
            makes,
            n_outputs,
            is_free,
            mean,
            1.0 / deviation**2,
            by_unit,
            np.array(powers),
            space,
        )

    @property
    def n_elements(self) -> int:
        """Capacities, conductances and gains."""
        return int(self.makes.shape[1])

    def features(self, u: FloatArray, unit: float) -> FloatArray:
        """Return one and what powers and factors are of, at points (n, p). Shape (n, 1 + p).

        Args:
            u: Points. [1]
            unit: The first output's unit in that of the scaled outputs.
        """
        lower, upper, theta = self.space.lower, self.space.upper, self.space.from_unit(u)
        away = 2.0 * (theta - 0.5 * (lower + upper)) / (upper - lower)
        # A positive parameter multiplies, whatever its scale.
        is_log = lower > 0.0
        with np.errstate(all="ignore"):
            logarithms = np.log(theta) - 0.5 * (np.log(lower) + np.log(upper))
        multiplied = np.where(is_log, logarithms, away)
        started = away * 0.5 * (upper - lower) * self.inputs.start_ratio * unit
        return np.column_stack([np.ones(len(u)), np.where(self.inputs.is_start, started, multiplied)])


@dataclass(frozen=True, eq=False)
class Network:
    """A network with powers and constants.

    Attributes:
        form: Its elements.
        weights: Constants and powers of the elements, then first states. Shape (q + s, 1 + p).
        level: What scaled outputs are zero at. [first output's unit]
        unit: The first output's unit in that of the scaled outputs.
    """

    form: NetworkForm
    weights: FloatArray
    level: float
    unit: float

    def outputs(self, u: FloatArray) -> FloatArray:
        """Return the outputs that are reported, at points (n, p). Shape (n, t, k). [output's unit]."""
        y, _ = self.solved(self.form.features(u, self.unit), with_slopes=False)
        return y / self.unit + self.level

    def solved(self, features: FloatArray, *, with_slopes: bool) -> tuple[FloatArray, FloatArray]:
        """Solve the network.

        Args:
            features: Of n points. Shape (n, 1 + p).
            with_slopes: Whether slopes are wanted.

        Returns:
            Scaled outputs, shape (n, t, k), and their slopes by the n points' elements and first states,
            shape (n, t k, q + s), or (n, 0, 0).
        """
        form, inputs = self.form, self.form.inputs
        values = features @ self.weights.T
        logarithms, start = values[:, : form.n_elements], values[:, form.n_elements :]
        rates = np.exp(np.clip(logarithms @ form.makes.T, -MOST_LOG, np.log(MOST_LOG / inputs.step)))
        potentials = (inputs.potentials - self.level) * self.unit
        y, slopes = steps(
            np.ascontiguousarray(start), rates, form.places, np.hstack([potentials, inputs.sources]),
            inputs.pattern, inputs.patterns, inputs.step, int(inputs.every[0]), form.n_outputs, with_slopes,
        )  # fmt: skip
        y = y[:, int(inputs.n_before[0]) :]
        if not with_slopes:
            return y, np.empty((len(y), 0, 0))
        slopes = slopes[:, int(inputs.n_before[0]) :].reshape(len(y), -1, slopes.shape[3])
        by_element = (slopes[:, :, : rates.shape[1]] * rates[:, None]) @ form.makes
        return y, np.concatenate([by_element, slopes[:, :, rates.shape[1] :]], axis=2)
