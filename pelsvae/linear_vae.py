"""The PELS-VAE whose encoder and decoder are linear and whose regressor is a Gaussian process.

With a linear encoder and decoder the optimum of Eq. 4 is known in closed form: it spans the principal
components of the trajectories (Tipping and Bishop 1999, doi:10.1111/1467-9868.00196), and encoding is
projection on them. What is left to learn is Eq. 6, the way from theta to the latent Gaussian, and a Gaussian
process gives just that, mean and variance. Decoding being linear, the mean of Eq. 7 is the decoded mean,
without draws. As an emulator of simulation models the form is that of Higdon et al. 2008,
doi:10.1198/016214507000000888.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pelsvae.kernel import CONSTANT, Kernel


class LinearVae(nn.Module):
    """Principal coordinates and the weighted mean of Gaussian processes of one form, m members.

    Shapes: b rows, f features of theta, d outputs (times x outputs), z latent, n training rows, m members.

    Attributes:
        kernel: Form of the members' kernels.
        basis: Principal components, orthonormal rows. Shape (z, d).
        x: Features of the training rows. Shape (n, f). [1]
        hyper: Hyperparameters of every member. Shape (m, h).
        share: Of every member in each code; those in one code sum up to 1. Shape (m, z).
        coefficients: Inverse of each member's covariances times the codes that it has a share in. Shape
            (m, n, z).
        amplitude: Variance of each code under each member. Shape (m, z).
        rest: Variance of the outputs outside the basis. Shape (d,).
        inflation: Factor that makes the stated deviation true on the validation set. Shape (d,).
    """

    basis: Tensor
    x: Tensor
    hyper: Tensor
    share: Tensor
    coefficients: Tensor
    amplitude: Tensor
    rest: Tensor
    inflation: Tensor
    warped: Tensor
    constant: Tensor
    slope: Tensor
    bend: Tensor

    def __init__(self, kernel: Kernel, **buffers: Tensor) -> None:
        """Take what was learnt.

        Args:
            kernel: Form of the kernels.
            buffers: The tensors among the attributes, by name.
        """
        super().__init__()
        self.kernel = kernel
        for name in ("basis", "x", "hyper", "share", "coefficients", "amplitude", "rest", "inflation"):
            self.register_buffer(name, buffers[name])
        # The polynomial, summed over the training rows: large terms of opposite sign meet in the same order
        # whatever is predicted, and a prediction need not sum them again.
        length = torch.stack([kernel.lengths(hyper)[0] for hyper in self.hyper])  # (m, f)
        squares = torch.stack([kernel.polynomial(hyper) for hyper in self.hyper])  # (m, degree)
        warped = torch.stack([kernel.warped(hyper, self.x) for hyper in self.hyper])
        self.register_buffer("warped", warped, persistent=False)
        far = warped / length[:, None].square()  # (m, n, f)
        self.register_buffer("constant", CONSTANT * self.coefficients.sum(dim=1), persistent=False)
        slope = squares[:, :1, None] * (far.transpose(1, 2) @ self.coefficients)
        self.register_buffer("slope", slope, persistent=False)
        if kernel.degree == 2:
            bend = torch.einsum("m,mni,mnj,mnz->mzij", squares[:, 1], far, far, self.coefficients)
            self.register_buffer("bend", bend, persistent=False)
        self._factors: list[Tensor] | None = None

    @property
    def no_draw(self) -> Tensor:
        """The one draw of Eq. 7 that a linear decoder needs, (1, z): all draws together have mean 0."""
        return self.basis.new_zeros(1, len(self.basis))

    def decoder(self, z: Tensor) -> Tensor:
        """Eq. 7: z (b, z) -> x (b, d)."""
        return z @ self.basis

    def regressor_mean(self, theta: Tensor) -> Tensor:
        """Mean of varphi(theta), Eq. 6: theta (b, f) -> (b, z)."""
        total = theta.new_zeros(())
        for member in range(len(self.hyper)):
            total = total + self.share[member] * self._member_mean(member, theta)
        return total

    def regressor_variance(self, theta: Tensor) -> Tensor:
        """Variance of varphi(theta), the members' disagreement included: theta (b, f) -> (b, z)."""
        center = self.regressor_mean(theta)
        total = theta.new_zeros(())
        for member, factor in enumerate(self._cholesky_factors()):
            hyper = self.hyper[member]
            covariance = self.kernel.matrix(hyper, self.x, theta)  # (n, b)
            explained = torch.linalg.solve_triangular(factor, covariance, upper=False).square().sum(dim=0)
            unexplained = (self.kernel.variances(hyper, theta) - explained).clamp_min(0.0)
            away = self._member_mean(member, theta) - center
            of_member = unexplained[:, None] * self.amplitude[member] + away.square()
            total = total + self.share[member] * of_member
        return total

    def predict(self, theta: Tensor, eps: Tensor) -> Tensor:
        """Eq. 6-7, without x: theta (b, f) -> x (b, d); draws cancel where decoding is linear."""
        del eps
        return self.decoder(self.regressor_mean(theta))

    def deviation(self, theta: Tensor) -> Tensor:
        """Standard deviation of what `predict` says: theta (b, f) -> (b, d)."""
        variance = self.regressor_variance(theta) @ self.basis.square() + self.rest
        return variance.sqrt() * self.inflation

    def _member_mean(self, member: int, theta: Tensor) -> Tensor:
        """Return a member's mean: theta (b, f) -> (b, z)."""
        near = self.kernel.warped(self.hyper[member], theta)
        bumps = self.kernel.bumps(self.hyper[member], near, self.warped[member])
        mean = bumps @ self.coefficients[member] + self.constant[member] + near @ self.slope[member]
        if self.kernel.degree == 2:
            mean = mean + torch.einsum("bi,zij,bj->bz", near, self.bend[member], near)
        return mean

    def _cholesky_factors(self) -> list[Tensor]:
        """Return every member's factor of the rows' covariances, made when first asked for. m of (n, n)."""
        if self._factors is None:
            self._factors = [torch.linalg.cholesky(self.kernel.noisy(hyper, self.x)) for hyper in self.hyper]
        return self._factors
