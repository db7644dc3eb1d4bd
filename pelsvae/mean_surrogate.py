"""The mean of several surrogates, each with a share: what their errors do not share cancels."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pelsvae.standardize import Array
from pelsvae.surrogate import Surrogate


@dataclass(frozen=True)
class MeanSurrogate:
    """A convex mean of surrogates of one model.

    Attributes:
        parts: The surrogates, of the same parameters and outputs.
        shares: What each counts; positive, with sum 1. Length m.
    """

    parts: tuple[Surrogate, ...]
    shares: tuple[float, ...]

    @property
    def log_columns(self) -> npt.NDArray[np.int64]:
        """Parameters that enter a part by their logarithm and so must be positive. Shape (q,)."""
        return np.unique(np.concatenate([one.log_columns for one in self.parts]))

    @property
    def n_threads(self) -> int | None:
        """Threads of torch that all parts predict with; None where they differ."""
        counts = {one.n_threads for one in self.parts}
        return counts.pop() if len(counts) == 1 else None

    def predict(self, theta: npt.ArrayLike, *, n_jobs: int = 1) -> Array:
        """Predict the trajectories of many parameter sets in one call.

        Args:
            theta: Parameters; a row with NaN is predicted as NaN. Shape (n, p). [per parameter]
            n_jobs: CPU cores that share the rows.

        Returns:
            Predicted outputs. Shape (n, t, k). [output's unit]

        Raises:
            ValueError: The shape is wrong, or a parameter that enters by its logarithm is not positive.
        """
        y = self.shares[0] * self.parts[0].predict(theta, n_jobs=n_jobs)
        for share, part in zip(self.shares[1:], self.parts[1:], strict=True):
            y += share * part.predict(theta, n_jobs=n_jobs)
        return y
