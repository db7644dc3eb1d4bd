"""The surrogate as a forward model: where the simulation room and the learning room meet."""

from dataclasses import dataclass

import numpy as np

from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.surrogate import Surrogate
from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.own_surrogate import OwnSurrogate


@dataclass(frozen=True)
class SurrogateModel:
    """A trained surrogate that answers like the model it was trained on.

    Rows outside the bounds are extrapolated, not refused; rows with NaN are failed rows.

    Attributes:
        surrogate: The trained network, or a mean of several.
        parameter_space: Parameters in the order of the training set's columns.
        output_names: Outputs in the order of the training set's.
        time: Output times of the training set. Shape (t,). [s]
        n_jobs: CPU cores that share the rows of a prediction.
    """

    surrogate: Surrogate | MeanSurrogate | OwnSurrogate
    parameter_space: ParameterSpace
    output_names: tuple[str, ...]
    time: FloatArray
    n_jobs: int = 1

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Predict every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The predictions, one per row; a row whose parameters or prediction are not finite has failed.
        """
        theta = np.asarray(theta, dtype=np.float64)
        no_logarithm = np.any(theta[:, self.surrogate.log_columns] <= 0.0, axis=1)
        usable = np.isfinite(theta).all(axis=1) & ~no_logarithm
        y = np.full((len(theta), len(self.time), len(self.output_names)), np.nan)
        if usable.any():
            predicted = self.surrogate.predict(theta[usable], n_jobs=self.n_jobs)
            if predicted.shape[1:] != y.shape[1:]:
                raise InputError(
                    f"the surrogate predicts {predicted.shape[1]} times of {predicted.shape[2]} outputs, the "
                    f"case has {y.shape[1]} of {y.shape[2]}; tune it again for this case and window"
                )
            y[usable] = predicted
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
            failures=["a logarithmic parameter is not positive" if bad else "" for bad in no_logarithm],
        )
