"""The PELS-VAE whose encoder and decoder are linear and whose regressor is a mean of Gaussian processes.

With a linear encoder and decoder the optimum of Eq. 4 is known in closed form: it spans the principal
components of the trajectories (Tipping and Bishop 1999, doi:10.1111/1467-9868.00196), and encoding is
projection on them. What is left to learn is Eq. 6, the way from theta to the latent Gaussian, and a Gaussian
process gives just that, mean and variance. Decoding being linear, the mean of Eq. 7 is the decoded mean,
without draws. As an emulator of simulation models the form is that of Higdon et al. 2008,
doi:10.1198/016214507000000888.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from pelsvae.kernel import CONSTANT, Kernel

# Covariances of so many rows and training rows are computed at once: 1 MiB, which stay near a core, and which
# the allocator keeps instead of taking fresh pages from the system.
# Before, fresh pages took more than half the time of predictions with 4,096 rows.
_AT_ONCE = 2**17
_TRAINING_ROWS_AT_ONCE = 128
_MOST_ROWS = 2048  # where training rows are few


class _Member(NamedTuple):
    """What a member's prediction takes, for the c codes that it has a share in.

    The polynomial is summed over the training rows: large terms of opposite sign meet in the same order
    whatever is predicted, and a prediction need not sum them again.
    """

    hyper: Tensor  # (h,)
    share: Tensor  # in its codes, 0 in the others: (c, z)
    bumps: list[tuple[Tensor, Tensor]]  # k rows in s scales: (f + 1 + s, s * k), coefficients (s * k, c)
    constant: Tensor  # (c,)
    slope: Tensor  # (f, c)
    bend: Tensor  # (f, c * f)


class LinearVae(nn.Module):
    """Principal coordinates and the weighted mean of m members, Gaussian processes of one form.

    Shapes: b rows, f features of theta, d outputs (times x outputs), z latent, n training rows, m members.

    Attributes:
        kernel: Form of the members' kernels.
        basis: Principal components, orthonormal rows. Shape (z, d).
        x: Features of the training rows. Shape (n, f). [1]
        hyper: Hyperparameters of every member. Shape (m, h).
        share: Of every process in each code, often 0; they sum up to 1. Shape (m, z).
        coefficients: Inverse of each member's covariances times the codes that it has a share in. Shape
            (m, n, z).
    """

    basis: Tensor
    x: Tensor
    hyper: Tensor
    share: Tensor
    coefficients: Tensor

    def __init__(self, kernel: Kernel, buffers: Mapping[str, Tensor]) -> None:
        """Set up predictions from what was fitted.

        Args:
            kernel: Form of the kernels.
            buffers: The tensors among the attributes, by name.
        """
        super().__init__()
        self.kernel = kernel
        # Surrogates that were saved before November 2026 have tensors beside these.
        for name in ("basis", "x", "hyper", "share", "coefficients"):
            self.register_buffer(name, buffers[name])
        self._known: list[_Member] | None = None

    @property
    def rows_at_once(self) -> int:
        """Rows whose prediction fits near a core."""
        return min(_MOST_ROWS, _AT_ONCE // min(len(self.x), _TRAINING_ROWS_AT_ONCE))

    @property
    def no_draw(self) -> Tensor:
        """The one draw of Eq. 7 that a linear decoder needs, (1, z): all draws together have mean 0."""
        return self.basis.new_zeros(1, len(self.basis))

    def predict(self, theta: Tensor, eps: Tensor) -> Tensor:
        """Eq. 6-7, without x: theta (b, f) -> x (b, d); draws cancel where decoding is linear."""
        del eps
        z = theta.new_zeros(1, len(self.basis))  # (b, z) with the first member: the mean of varphi(theta)
        for member in self._members():
            # A product with zeros, not `index_add`: torch 2.13 exports that to ONNX as another sum.
            z = z + self._member_mean(member, theta) @ member.share
        return z @ self.basis

    def _member_mean(self, member: _Member, theta: Tensor) -> Tensor:
        """Return a member's mean in its codes: theta (b, f) -> (b, c)."""
        near = self.kernel.warped(member.hyper, theta)
        mean = member.constant + near @ member.slope
        if self.kernel.degree == 2:
            # A quadratic form per code, summed over training rows beforehand: they cost nothing here.
            bent = (near @ member.bend).reshape(near.shape[0], -1, near.shape[1])  # (b, c, f)
            mean = mean + (bent @ near[:, :, None])[:, :, 0]
        points = self.kernel.near(member.hyper, near)
        for far, coefficients in member.bumps:
            mean = mean + (points @ far).exp2_() @ coefficients
        return mean

    def _members(self) -> list[_Member]:
        """Return what predictions take, made when first asked for."""
        if self._known is None:
            # What inference mode makes could not be differentiated later.
            with torch.inference_mode(False), torch.no_grad():
                self._known = [self._member(place) for place in range(len(self.hyper))]
        return self._known

    def _member(self, place: int) -> _Member:
        hyper, kernel = self.hyper[place], self.kernel
        columns = self.share[place].nonzero()[:, 0]
        coefficients = self.coefficients[place][:, columns].contiguous()
        warped = kernel.warped(hyper, self.x)
        # A GPU gains by few large products, a core by blocks that stay in its cache.
        at_once = len(warped) if warped.is_cuda else _TRAINING_ROWS_AT_ONCE
        bumps = []
        for start in range(0, len(warped), at_once):
            rows = slice(start, start + at_once)
            # All scales side by side: one product and one power serve them all.
            far = torch.cat(list(kernel.far(hyper, warped[rows])), dim=1)
            bumps.append((far, coefficients[rows].repeat(kernel.n_scales, 1)))
        squares = kernel.polynomial(hyper)  # (degree,)
        across = warped / kernel.lengths(hyper)[0].square()  # (n, f)
        bend = across.new_zeros(0)
        if kernel.degree == 2:
            products = squares[1] * coefficients.T[:, :, None] * across  # (c, n, f)
            bend = (across.T @ products).permute(1, 0, 2).reshape(across.shape[1], -1)
        return _Member(
            hyper=hyper,
            share=torch.diag(self.share[place])[columns],
            bumps=bumps,
            constant=CONSTANT * coefficients.sum(dim=0),
            slope=squares[0] * (across.T @ coefficients),
            bend=bend,
        )
