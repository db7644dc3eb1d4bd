"""The settings record: what it accepts, what it refuses and that JSON holds it."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from pelsvae.config import VARIANTS, SurrogateConfig


@pytest.mark.parametrize("name", sorted(VARIANTS))
def test_config_survives_json(name: str) -> None:
    config = VARIANTS[name]
    assert SurrogateConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_unknown_setting_is_named() -> None:
    with pytest.raises(ValueError, match=r"unknown surrogate settings \['n_latnet'\]"):
        SurrogateConfig.from_dict({"n_latnet": 8})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_latent": 0}, "n_latent = 0 must be at least 1"),
        ({"n_latent": 8.0}, "n_latent = 8.0 must be int"),
        ({"beta": 0}, "beta = 0 must be positive"),
        ({"beta": float("nan")}, "beta = nan must be positive"),
        ({"activation": "tanh"}, r"activation = 'tanh' must be one of \['relu', 'silu'\]"),
        ({"weight_decay": 0.1, "optimizer": "adam"}, "belongs to optimizer 'adamw'"),
    ],
)
def test_impossible_setting_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SurrogateConfig().replace(**changes)


def test_config_imports_without_torch() -> None:
    code = "import sys, pelsvae.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
