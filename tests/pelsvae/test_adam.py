"""Adam without torch's compiler: the same bits as torch.optim, and the compiler is not loaded."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from pelsvae.adam import Adam


@pytest.mark.parametrize("decay", [0.0, 0.1])
def test_steps_are_those_of_torch(decay: float) -> None:
    generator = torch.Generator().manual_seed(0)
    first = [torch.randn(shape, generator=generator) for shape in ((5, 7), (3,))]
    ours, theirs = ([weight.clone().requires_grad_() for weight in first] for _ in range(2))
    adam = Adam(ours, betas=(0.9, 0.99), decay=decay)
    peer: torch.optim.Optimizer
    if decay:
        peer = torch.optim.AdamW(theirs, lr=1.0, betas=(0.9, 0.99), weight_decay=decay, fused=True)
    else:
        peer = torch.optim.Adam(theirs, lr=1.0, betas=(0.9, 0.99), fused=True)
    for learning_rate in (0.01, 0.1, 0.03):
        adam.forget_gradients()
        peer.zero_grad()
        for weights in (ours, theirs):
            sum(weight.square().sin().sum() for weight in weights).backward()  # type: ignore[union-attr]
        adam.step(learning_rate)
        peer.param_groups[0]["lr"] = learning_rate
        peer.step()
        for mine, other, before in zip(ours, theirs, first, strict=True):
            assert torch.equal(mine, other)
            assert not torch.equal(mine, before)


def test_a_weight_without_gradient_is_refused() -> None:
    with pytest.raises(RuntimeError):
        Adam([torch.ones(2)]).step(0.1)


@pytest.mark.parametrize("variant", ["paper", "refined"])
def test_a_training_loads_neither_torchs_compiler_nor_sympy(variant: str, tmp_path: Path) -> None:
    script = f"""
import sys
import numpy as np
from pelsvae.config import VARIANTS
from pelsvae.surrogate import Surrogate
from pelsvae.training import fit
rows = np.linspace(1.0, 2.0, 8)[:, None], np.ones((8, 3, 1)) * np.linspace(0.0, 1.0, 8)[:, None, None]
config = VARIANTS[{variant!r}].replace(max_epochs=2, device="cpu")
fit(*rows, rows, config=config, seed=0).surrogate.save({str(tmp_path)!r})
Surrogate.load({str(tmp_path)!r}).predict(rows[0])
assert not {{"torch._dynamo", "sympy"}} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", script], check=True)
