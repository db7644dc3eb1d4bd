"""A few networks from theta to the principal coordinates: one more candidate beside the processes.

Where trajectories shift in time, coordinates turn over and over along a parameter, and stationary bumps need
many rows for every turn; layers need fewer. What they say is multiplied by powers of the parameters, because
the size of trajectories often is one, and layers can only add.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn


class NetworkEnsemble(nn.Module):
    """Layers with a leading dimension of e networks; computes in the precision of its layers.

    Shapes: b rows, f features of theta, z latent, e networks, layers of i inputs and o outputs.

    Attributes:
        share: Of the networks' mean in each code. Shape (z,).
        power: A feature's, in the factor of what the layers say. Shape (e, f, 1).
        origin: Codes where that factor is zero. Shape (e, 1, z).
    """

    share: Tensor
    power: Tensor
    origin: Tensor

    def __init__(self, layers: Mapping[str, Tensor]) -> None:
        """Take what was learnt.

        Args:
            layers: "share", "power", "origin", and by layer from 0 "weight_0", "bias_0" and so on.

        Raises:
            KeyError: One of the first three is missing.
        """
        super().__init__()
        others = ("share", "power", "origin")
        for name in (*others, *(name for name in layers if name not in others)):
            self.register_buffer(name, layers[name])
        self._n_layers = (len(layers) - len(others)) // 2

    @property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weights (e, i, o) and biases (e, 1, o), first to last."""
        return [
            (self.get_buffer(f"weight_{place}"), self.get_buffer(f"bias_{place}"))
            for place in range(self._n_layers)
        ]

    def each(self, theta: Tensor) -> Tensor:
        """What every network says of features (b, f) -> (e, b, z), computed in the layers' precision."""
        x = theta.to(self.power.dtype).expand(len(self.power), *theta.shape)
        factor = torch.exp(x @ self.power)  # (e, b, 1)
        *others, (last_weight, last_bias) = self.layers
        for weight, bias in others:
            x = nn.functional.silu(torch.baddbmm(bias, x, weight))
        said = factor * torch.baddbmm(last_bias, x, last_weight) + self.origin
        return said.to(theta.dtype)
