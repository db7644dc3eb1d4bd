"""Where what belongs to an experiment stands among what belongs to all."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.measurement import MeasuredOutput, Measurement
from simulation.trajectories import Trajectories

Names = tuple[tuple[str, ...], tuple[str, ...]]
MARK = "@"
"""Between the name of an output or a parameter and that of the experiment that it belongs to."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Where what belongs to an experiment stands among what belongs to all.

    Attributes:
        name: Its name.
        parameters: Columns of its q parameters among the p of all. Shape (q,).
        outputs: Columns of its l outputs among the k of all. Shape (l,).
        n_times: How many of the output times it has, from the first on.
    """

    name: str
    parameters: IntArray
    outputs: IntArray
    n_times: int


@dataclass(frozen=True, eq=False)
class Layout:
    """How rows of several experiments become one.

    All begin at time 0. A shorter experiment keeps its last values until the longest ends: they are not
    compared with anything.

    Attributes:
        parameter_names: Names of the p parameters of all experiments.
        output_names: Names of the k outputs of all experiments.
        time: Output times of the longest. Shape (t,). [s]
        experiments: The experiments.
    """

    parameter_names: tuple[str, ...]
    output_names: tuple[str, ...]
    time: FloatArray
    experiments: tuple[Experiment, ...]

    def theta_of(self, experiment: Experiment, theta: FloatArray) -> FloatArray:
        """Return an experiment's own parameters. Shapes (n, p) and (n, q). [per parameter]."""
        return np.ascontiguousarray(theta[:, experiment.parameters])

    def part(
        self, experiment: Experiment, rows: Trajectories, names: Names, time: FloatArray
    ) -> Trajectories:
        """Return what rows are in one experiment.

        Args:
            experiment: The experiment.
            rows: Rows of all experiments.
            names: Its parameters and outputs.
            time: Its output times. Shape (t,). [s]
        """
        y = np.ascontiguousarray(rows.y[:, : experiment.n_times, experiment.outputs])
        return Trajectories(self.theta_of(experiment, rows.theta), y, time, *names, rows.failures)

    def join(self, theta: FloatArray, answers: Sequence[Trajectories]) -> Trajectories:
        """Put the answers of all experiments side by side.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            answers: Each experiment's answer to its part of the same rows.

        Returns:
            The rows; one that failed in an experiment is a failed one.
        """
        y = np.empty((len(theta), len(self.time), len(self.output_names)))
        reasons = [""] * len(theta)
        for one, answer in zip(self.experiments, answers, strict=True):
            y[:, : one.n_times, one.outputs] = answer.y
            y[:, one.n_times :, one.outputs] = answer.y[:, -1:]
            for row, reason in enumerate(answer.failures):
                reasons[row] = reasons[row] or (reason and f"experiment {one.name}: {reason}")
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=self.parameter_names,
            output_names=self.output_names,
            failures=reasons,
        )


def joined_measurement(parts: Sequence[tuple[str, Measurement, float]]) -> Measurement:
    """Put the measurements of experiments side by side, over the output times of the longest.

    Args:
        parts: Of each experiment its name, its measurement, and the share of its outputs relative to the
            others'. [1]
    """
    outputs = list[MeasuredOutput]()
    for name, one, weight in parts:
        begin_s, length_s = one.time[0], one.time[-1] - one.time[0]
        outputs += (
            replace(
                its,
                name=f"{its.name}{MARK}{name}",
                samples=its.samples.within(begin_s, length_s),
                weight=its.weight * weight,
                limits=its.limits and its.limits.within(begin_s, length_s),
            )
            for its in one.outputs
        )
    longest = max((one.time for _, one, _ in parts), key=len)
    return Measurement(longest - longest[0], tuple(outputs))
