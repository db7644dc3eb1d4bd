"""Adam on torch's fused kernel, without the compiler that `torch.optim` loads.

It does so as soon as an optimizer is made, which takes every process that trains some two seconds, more than
many a training. The bits are those of `torch.optim`.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

_EPS = 1e-8


class Adam:
    """Kingma and Ba 2015, arXiv:1412.6980, with a decay as of Loshchilov and Hutter 2019, arXiv:1711.05101.

    Gradients are read from the tensors' `grad`, and moments start at zero.
    """

    def __init__(
        self, weights: Sequence[Tensor], *, betas: tuple[float, float] = (0.9, 0.999), decay: float = 0.0
    ) -> None:
        """Take what is learnt.

        Args:
            weights: Changed in place by `step`. They share a device.
            betas: Decay rates of the moments.
            decay: Of the weights, decoupled from their gradients; times the learning rate per step.
        """
        self._weights = list(weights)
        self._betas, self._decay = betas, decay
        self._mean = [torch.zeros_like(weight) for weight in self._weights]
        self._square = [torch.zeros_like(weight) for weight in self._weights]
        self._n_steps = [weight.new_zeros((), dtype=torch.float32) for weight in self._weights]

    def forget_gradients(self) -> None:
        """Let the next gradients be written instead of added."""
        for weight in self._weights:
            weight.grad = None

    def step(self, learning_rate: float) -> None:
        """Take one step.

        Args:
            learning_rate: Of this step.

        Raises:
            RuntimeError: A weight has no gradient.
        """
        gradients = [weight.grad for weight in self._weights if weight.grad is not None]
        with torch.no_grad():
            torch._foreach_add_(self._n_steps, 1.0)
            torch._fused_adamw_(
                self._weights,
                gradients,
                self._mean,
                self._square,
                [],
                self._n_steps,
                lr=learning_rate,
                beta1=self._betas[0],
                beta2=self._betas[1],
                weight_decay=self._decay,
                eps=_EPS,
                amsgrad=False,
                maximize=False,
            )
