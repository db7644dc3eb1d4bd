"""Principal coordinates, and for each of them its own Gaussian process (GPyTorch)."""

from dataclasses import dataclass
from typing import Any

import gpytorch
import numpy as np
import torch
from gpytorch.constraints import GreaterThan
from gpytorch.kernels import Kernel, LinearKernel, MaternKernel, RBFKernel, ScaleKernel
from gpytorch.priors import LogNormalPrior, NormalPrior
from linear_operator.utils.errors import NotPSDError
from scipy.optimize import minimize
from torch import Tensor

from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Clock, Features, Fitted, Principal
from surrogate_rivals.problems import Data

# Rows that hyperparameters are learnt from: kernel and start from few, then more for what weighs more.
FEW_ROWS, MORE_ROWS, MOST_ROWS = 128, 256, 512
FEW_STEPS, MORE_STEPS = 30, 15
# So many coordinates, the leading ones, learn from most and from more rows, and choose among kernels at all.
N_MOST, N_MORE, N_CHOOSING = 6, 20, 24
LEFT_OUT = 1e-5  # of the variance
# Lengths in widths of the box: most probable value, and how far they may spread around it (logarithms).
PRIORS = ((1.5, 1.0), (3.0, 0.4))
NOISE_FLOOR = 1e-8
IMPROBABLE = 1e10
CHUNK_ROWS = 1000


class _Process(gpytorch.models.ExactGP):  # type: ignore[misc]
    """Bumps and a linear part in the same lengths, one per feature; the inputs warped where asked.

    The warp is the distribution function of Kumaraswamy, two exponents per feature.
    """

    def __init__(
        self, x: Tensor, y: Tensor, kernel: str, length: tuple[float, float], *, is_warped: bool
    ) -> None:
        likelihood = gpytorch.likelihoods.GaussianLikelihood(
            noise_prior=LogNormalPrior(np.log(1e-5), 3.0), noise_constraint=GreaterThan(NOISE_FLOOR)
        )
        super().__init__(x, y, likelihood)
        bumps: Kernel = RBFKernel() if kernel == "rbf" else MaternKernel(nu=2.5)
        bumps.raw_lengthscale.requires_grad_(False)
        bumps.lengthscale = 1.0
        linear = LinearKernel(variance_prior=LogNormalPrior(0.0, 2.0))
        self.mean_module = gpytorch.means.ConstantMean(constant_prior=NormalPrior(0.0, 2.0))
        self.covar_module = ScaleKernel(bumps, outputscale_prior=LogNormalPrior(0.0, 2.0)) + linear
        likelihood.noise = 1e-4
        self.is_warped = is_warped
        logs = {"log_length": (np.log(length[0]), np.log(length[0]), length[1])}
        if is_warped:
            logs |= {"log_rise": (0.0, 0.0, 0.5), "log_fall": (0.0, 0.0, 0.5)}
        for name, (value, middle, spread) in logs.items():
            self.register_parameter(name, torch.nn.Parameter(torch.full(x.shape[1:], float(value))))
            self.register_prior(f"{name}_prior", NormalPrior(middle, spread), name)

    def forward(self, x: Tensor) -> gpytorch.distributions.MultivariateNormal:
        x = self.inputs(x)
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    def inputs(self, x: Tensor) -> Tensor:
        """Return the features that the kernel sees. Shape (n, f)."""
        if self.is_warped:
            u = (x + 0.5).clamp(1e-6, 1.0 - 1e-6)
            x = 0.5 - (1.0 - u ** self.log_rise.exp()) ** self.log_fall.exp()
        seen: Tensor = x / self.log_length.exp()
        return seen

    def kernel(self, x: Tensor, other: Tensor) -> Tensor:
        """Return the covariance of two sets of rows. Shape (n, m)."""
        matrix: Tensor = self.covar_module(self.inputs(x), self.inputs(other)).to_dense()
        return matrix

    def factor(self, x: Tensor) -> Tensor:
        """Return the Cholesky factor of the training rows' covariance. Shape (n, n)."""
        matrix = self.kernel(x, x)
        matrix.diagonal().add_(self.likelihood.noise.squeeze() + 1e-10 * matrix.diagonal().mean())
        lower: Tensor = torch.linalg.cholesky(matrix)
        return lower


@dataclass(frozen=True, eq=False)
class _Coordinate:
    """A process that knows all training rows.

    Attributes:
        process: With its hyperparameters.
        scale: Deviation of the coordinate.
        weights: Covariance's inverse times the values. Shape (n, 1).
    """

    process: _Process
    scale: float
    weights: Tensor

    @classmethod
    def of(cls, process: _Process, x: Tensor, z: Tensor) -> "_Coordinate":
        """Let a process know rows."""
        with torch.no_grad():
            scale = float(z.std())
            values = z / scale - process.mean_module.constant
            return cls(process, scale, torch.cholesky_solve(values[:, None], process.factor(x)))

    def mean(self, x: Tensor, rows: Tensor) -> Tensor:
        """Predict from the rows that are known. Shape (m,)."""
        with torch.no_grad():
            parts = [self.process.kernel(part, rows) @ self.weights for part in torch.split(x, CHUNK_ROWS)]
            mean: Tensor = (torch.cat(parts)[:, 0] + self.process.mean_module.constant) * self.scale
            return mean

    def variance(self, x: Tensor, rows: Tensor) -> Tensor:
        """Return the variance of a prediction. Shape (m,)."""
        with torch.no_grad():
            known = torch.linalg.solve_triangular(
                self.process.factor(rows), self.process.kernel(rows, x), upper=False
            )
            own = self.process.kernel(x, x).diagonal() + self.process.likelihood.noise.squeeze()
            variance: Tensor = (own - (known**2).sum(dim=0)).clamp_min(NOISE_FLOOR) * self.scale**2
            return variance


def gaussian_processes(data: Data, seed: int, *, is_warped: bool) -> Fitted:
    """Learn each coordinate's kernel by its marginal likelihood, then let it know all rows.

    RBF or Matérn 5/2, and of few rows how even the lengths are, is chosen per coordinate by validation. The
    process sees both kinds of features, or warped logarithmic ones. Hyperparameters come from 128 rows, those
    of the leading coordinates from 256 and from 512; coordinates after the 24th share the last ones.
    The band is the processes' own.
    """
    del seed  # nothing is drawn
    features, principal = Features.of(data.space), Principal.of(data, LEFT_OUT)

    def seen(theta: FloatArray) -> Tensor:
        rows = features.logarithmic(theta) if is_warped else features.both(theta)
        return torch.from_numpy(rows)

    x, z = seen(data.theta), torch.from_numpy(principal.coordinates(data.y))
    x_validation = seen(data.validation[0])
    z_validation = torch.from_numpy(principal.coordinates(data.validation[1]))
    processes: list[_Process] = []
    for j in range(z.shape[1]):
        known = (x_validation, z_validation[:, j])
        processes.append(_learnt(x, z[:, j], known, j, processes[-1:], is_warped=is_warped))
    clock = Clock()
    coordinates = [_Coordinate.of(process, x, z[:, j]) for j, process in enumerate(processes)]
    fit_s = clock.s

    def predict(theta: FloatArray) -> FloatArray:
        rows = seen(theta)
        return principal.outputs(torch.stack([one.mean(rows, x) for one in coordinates], dim=1).numpy())

    def deviation(theta: FloatArray) -> FloatArray:
        rows = seen(theta)
        return principal.deviation(torch.stack([one.variance(rows, x) for one in coordinates], dim=1).numpy())

    n_even = sum(float(one.process.log_length_prior.scale.mean()) < 0.5 for one in coordinates)
    n_rbf = sum(isinstance(one.process.covar_module.kernels[0].base_kernel, RBFKernel) for one in coordinates)
    return Fitted(predict, fit_s, f"{len(coordinates)} coordinates, {n_rbf} by RBF, {n_even} even", deviation)


def _learnt(
    x: Tensor,
    z: Tensor,
    validation: tuple[Tensor, Tensor],
    rank: int,
    before: list[_Process],
    *,
    is_warped: bool,
) -> _Process:
    """Learn a coordinate's hyperparameters; one far down takes those of the coordinate before."""
    if rank >= N_CHOOSING:
        return before[0]
    y = z / z.std()
    rows = min(FEW_ROWS, len(x))
    found: list[tuple[float, int, _Process]] = []
    for kernel in ("rbf", "matern"):
        # Few rows do not determine all lengths: then they may be kept even.
        for length in PRIORS if len(x) <= FEW_ROWS else PRIORS[:1]:
            process = _Process(x[:rows], y[:rows], kernel, length, is_warped=is_warped)
            _maximize_likelihood(process, FEW_STEPS)
            guess = _Coordinate.of(process, x[:rows], z[:rows]).mean(validation[0], x[:rows])
            found.append((float(((guess - validation[1]) ** 2).mean()), len(found), process))
    process = min(found)[2]
    for more, last in ((MORE_ROWS, N_MORE), (MOST_ROWS, N_MOST)):
        if len(x) > rows and rank < last:
            rows = min(more, len(x))
            process.set_train_data(x[:rows], y[:rows], strict=False)
            _maximize_likelihood(process, MORE_STEPS)
    return process


def _maximize_likelihood(process: _Process, steps: int) -> None:
    """Move hyperparameters to their most probable values by L-BFGS-B."""
    process.train()
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(process.likelihood, process)
    weights: list[Any] = [weight for weight in process.parameters() if weight.requires_grad]
    sizes = [weight.numel() for weight in weights]
    (x,), y = process.train_inputs, process.train_targets

    def put(point: FloatArray) -> None:
        with torch.no_grad():
            for weight, values in zip(weights, torch.split(torch.from_numpy(point), sizes), strict=True):
                weight.copy_(values.reshape(weight.shape))

    def loss(point: FloatArray) -> tuple[float, FloatArray]:
        put(point)
        process.zero_grad()
        try:
            with gpytorch.settings.fast_computations(False, False, False):
                value = -objective(process(x), y)
        except NotPSDError:  # on some ways to the optimum a matrix is singular to all digits: turn back
            return IMPROBABLE, np.zeros_like(point)
        value.backward()
        return float(value.detach()), torch.cat([weight.grad.flatten() for weight in weights]).numpy()

    start = torch.cat([weight.detach().flatten() for weight in weights]).numpy()
    best = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": steps})
    put(best.x)
