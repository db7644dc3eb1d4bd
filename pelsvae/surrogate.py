"""A trained PELS-VAE as a function: parameters in, trajectories out, in float64 NumPy."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pelsvae.config import SurrogateConfig
from pelsvae.device import n_threads_set
from pelsvae.linear_vae import LinearVae
from pelsvae.network import PelsVae
from pelsvae.standardize import Array, OutputStandardizer, ThetaStandardizer

_CHUNK_ROWS_CUDA = 4096  # fewer and larger launches of kernels


@dataclass(frozen=True)
class Surrogate:
    """The emulator of Eq. 6-7 with its draws fixed, hence a smooth and repeatable function of theta.

    Attributes:
        config: How it was built and trained.
        network: Encoder, decoder, regressor, in evaluation mode.
        eps: The fixed standard normal draws of Eq. 7, in the network's precision. Shape (L, z).
        theta_standardizer: Parameters to features.
        output_standardizer: Trajectories to network outputs and back.
    """

    config: SurrogateConfig
    network: PelsVae | LinearVae
    eps: Tensor
    theta_standardizer: ThetaStandardizer
    output_standardizer: OutputStandardizer

    @property
    def log_columns(self) -> npt.NDArray[np.int64]:
        """Parameters that enter by their logarithm and so must be positive. Shape (q,)."""
        return self.theta_standardizer.log_columns

    @property
    def n_threads(self) -> int | None:
        """Threads of torch that predictions are made with; who predicts often sets them once."""
        return self.config.n_threads

    def predict(self, theta: npt.ArrayLike, *, n_jobs: int = 1) -> Array:
        """Predict the trajectories of many parameter sets in one call.

        Args:
            theta: Parameters; a row with NaN is predicted as NaN. Shape (n, p). [per parameter]
            n_jobs: CPU cores that share the rows, each in its own thread: the same bits, sooner.

        Returns:
            Predicted outputs. Shape (n, t, k). [output's unit]

        Raises:
            ValueError: The shape is wrong, or a parameter that enters by its logarithm is not positive.
        """
        features = self.theta_standardizer.features(self._checked(theta), self.eps.dtype)  # (n, f)
        size = _CHUNK_ROWS_CUDA if self.eps.is_cuda else self.network.rows_at_once
        y = np.empty((len(features), *self.output_standardizer.mean.shape))

        def predict_from(start: int) -> None:
            # Inference mode belongs to a thread.
            with torch.inference_mode():
                x = self.network.predict(features[start : start + size], self.eps).cpu().numpy()
                y[start : start + size] = self.output_standardizer.physical(x)

        starts = range(0, len(features), size)
        # A new thread computes with as many threads as the machine has cores until it asks torch; with how
        # many decides digits, and the linear algebra takes fewer on a busy machine.
        asked = torch.get_num_threads
        # Threads suffice: torch computes without the interpreter's lock.
        with (
            n_threads_set(self.config.n_threads),
            ThreadPoolExecutor(max(1, n_jobs), initializer=asked) as threads,
        ):
            list((threads.map if n_jobs > 1 and len(starts) > 1 else map)(predict_from, starts))
        return y

    def _checked(self, theta: npt.ArrayLike) -> Tensor:
        """Return theta (n, p) where the network is, in float64; ValueError for a wrong shape or value."""
        # A copy: torch shares the memory, and the caller may change its own.
        rows = np.array(theta, dtype=np.float64, order="C")
        p = self.theta_standardizer.n_parameters
        if rows.ndim != 2 or rows.shape[1] != p:
            raise ValueError(f"theta has shape {rows.shape}; this surrogate takes (n, {p})")
        require_positive(rows, self.theta_standardizer.log_columns)
        return torch.from_numpy(rows).to(self.eps.device)


def require_positive(theta: Array, log_columns: npt.NDArray[np.int64]) -> None:
    """Raise ValueError where a parameter that enters by its logarithm is zero or less; NaN passes.

    Args:
        theta: Parameters. Shape (..., p).
        log_columns: Indices of the columns. Shape (q,).
    """
    bad = [int(column) for column in log_columns if (theta[..., column] <= 0.0).any()]
    if bad:
        raise ValueError(f"parameter columns {bad} enter by their logarithm and must be positive")


def draw_prediction_eps(n_samples: int, n_latent: int, generator: torch.Generator) -> Tensor:
    """Draw the fixed samples of Eq. 7 as antithetic pairs (eps, -eps).

    Each draw alone is standard normal; in pairs their mean is zero, which is what the mean of Eq. 7 tends to.

    Args:
        n_samples: L.
        n_latent: Dimension of z.
        generator: Source (CPU).

    Returns:
        Shape (L, z), float32.
    """
    half = torch.randn((n_samples + 1) // 2, n_latent, generator=generator)
    return torch.cat([half, -half])[:n_samples]
