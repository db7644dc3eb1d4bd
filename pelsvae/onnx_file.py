"""A surrogate as an ONNX file: the same function of the parameters for programs without torch."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.surrogate import Surrogate

INPUT, OUTPUT = "theta", "y"
"""Names of the graph's input and output."""


def onnx_bytes(surrogate: Surrogate | MeanSurrogate, *, metadata: Mapping[str, str]) -> bytes:
    """Return a surrogate as a graph with physical units on both sides; any number of rows goes through it.

    Its input has shape (n, p) and its output shape (n, t, k), both float64. Inside, precision is that of the
    surrogate.

    Args:
        surrogate: What to write; a mean is written as the sum of its parts.
        metadata: Kept in the file, for programs that read it.

    Returns:
        The content of an ONNX file.

    Raises:
        ModuleNotFoundError: onnx or onnxscript is not installed.
    """
    mean = surrogate if isinstance(surrogate, MeanSurrogate) else MeanSurrogate((surrogate,), (1.0,))
    first = mean.parts[0]
    rows = np.ones((2, first.theta_standardizer.n_parameters))
    surrogate.predict(rows)  # what is computed once must not become a part of the graph
    exporter = logging.getLogger("torch.onnx")
    level = exporter.level
    with warnings.catch_warnings():
        # Deprecations inside the exporter, and packages that it misses and that are of no use here.
        warnings.simplefilter("ignore")
        exporter.setLevel(logging.ERROR)
        try:
            program = torch.onnx.export(
                _Mean(mean).eval() if len(mean.parts) > 1 else _Physical(first).eval(),
                (torch.from_numpy(rows).to(first.eps.device),),
                input_names=[INPUT],
                output_names=[OUTPUT],
                dynamic_shapes=({0: torch.export.Dim("n")},),
                dynamo=True,
                verbose=False,
            )
        finally:
            exporter.setLevel(level)
    assert program is not None, "dynamo returns one"
    for node in program.model.graph:
        node.metadata_props.clear()  # lines of source code and the places of their files
    program.model.metadata_props.update(metadata)
    return program.model_proto.SerializeToString()


class _Mean(nn.Module):
    """Parameters to the mean of several surrogates' outputs."""

    def __init__(self, mean: MeanSurrogate) -> None:
        super().__init__()
        self.parts, self.shares = nn.ModuleList(map(_Physical, mean.parts)), mean.shares

    def forward(self, theta: Tensor) -> Tensor:
        """Parameters theta (n, p) -> y (n, t, k)."""
        each = [share * part(theta) for share, part in zip(self.shares, self.parts, strict=True)]
        return torch.stack(each).sum(dim=0)


class _Physical(nn.Module):
    """Parameters to outputs, the scaling of both included."""

    eps: Tensor
    mean: Tensor
    deviation: Tensor

    def __init__(self, surrogate: Surrogate) -> None:
        super().__init__()
        self.network = surrogate.network
        self.theta_standardizer = surrogate.theta_standardizer
        scale, device = surrogate.output_standardizer, surrogate.eps.device
        self.register_buffer("eps", surrogate.eps)
        self.register_buffer("mean", torch.as_tensor(scale.mean, device=device))
        self.register_buffer("deviation", torch.as_tensor(scale.deviation, device=device))

    def forward(self, theta: Tensor) -> Tensor:
        """Parameters theta (n, p) -> y (n, t, k)."""
        features = self.theta_standardizer.features(theta, self.eps.dtype)
        x = self.network.predict(features, self.eps)
        return x.to(torch.float64).reshape(-1, *self.mean.shape) * self.deviation + self.mean
