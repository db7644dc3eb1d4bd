"""Time the surrogate: training per size, epochs, predictions of 10,000 rows, Jacobian.

Run as `python tests/benchmarks/surrogate_speed.py [--json FILE]`; prints ratios within one run and gates
nothing. Times are CPU seconds, which other work on the machine disturbs least.
The data is a sum of closed-form RC steps in the office's size: 14 parameters, 481 times.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from pelsvae.config import VARIANTS
from pelsvae.network import latent_samples
from pelsvae.surrogate import Surrogate
from pelsvae.training import fit

N_PARAMETERS, N_TIMES, N_ROWS = 14, 481, 10_000
SIZES = (32, 64, 128, 256)


def data(n: int, seed: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return theta (n, 14) in [0.2, 5] and the sum of seven step responses, y (n, 481, 1)."""
    theta = np.random.default_rng(seed).uniform(0.2, 5.0, size=(n, N_PARAMETERS))
    time_d = np.linspace(0.0, 10.0, N_TIMES)
    rate = 1.0 / (theta[:, :7, None] * np.arange(1.0, 8.0)[:, None] / 4.0)  # (n, 7, 1)
    y = (theta[:, 7:, None] * (1.0 - np.exp(-time_d * rate))).sum(axis=1)
    return theta, 20.0 + y[:, :, None]


def seconds(function: Callable[[], object], n_repeats: int = 5) -> float:
    """Return the fastest of some calls after one that warms up. [s]"""
    function()
    times = []
    for _ in range(n_repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def predict_sample_by_sample(surrogate: Surrogate, theta: npt.NDArray[np.float64]) -> None:
    """Do what Eq. 7 says literally: decode each of the L samples in full, then average."""
    features = surrogate.theta_standardizer.features(torch.from_numpy(theta), torch.float32)
    with torch.inference_mode():
        mean, log_variance = surrogate.network.regressor(features)
        total = torch.zeros(len(theta), N_TIMES)
        for eps in surrogate.eps:
            total += surrogate.network.decoder(
                latent_samples(mean, log_variance, eps[None, None, :]), features
            )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--threads", type=int, default=1, help="CPU threads of torch (default 1)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    numbers: dict[str, float] = {}
    validation = data(320, seed=1)
    for variant, config in VARIANTS.items():
        for n in SIZES:
            timed = config.replace(device="cpu", max_epochs=200, patience=200, validate_every=20)
            start = time.process_time()
            result = fit(*data(n, seed=0), validation, config=timed, seed=0)
            per_epoch = (time.process_time() - start) / result.n_epochs
            numbers[f"{variant} n={n} ms_per_epoch"] = 1e3 * per_epoch
            ratio = per_epoch / (numbers[f"{variant} n={SIZES[0]} ms_per_epoch"] / 1e3)
            print(
                f"{variant:8s} n = {n:4d}: {1e3 * per_epoch:6.2f} ms per epoch, validation included "
                f"({ratio:4.1f} x n = {SIZES[0]}); "
                f"{config.max_epochs} epochs {config.max_epochs * per_epoch:5.1f} s"
            )
        surrogate = result.surrogate
        theta, _ = data(N_ROWS, seed=2)
        together = seconds(lambda s=surrogate, t=theta: s.predict(t))  # type: ignore[misc]
        literal = seconds(lambda s=surrogate, t=theta: predict_sample_by_sample(s, t), n_repeats=2)  # type: ignore[misc]
        jacobian = seconds(lambda s=surrogate, t=theta: s.jacobian(t[0]))  # type: ignore[misc]
        numbers[f"{variant} predict_10000_s"] = together
        numbers[f"{variant} predict_10000_literal_over_ours"] = literal / together
        numbers[f"{variant} jacobian_ms"] = 1e3 * jacobian
        print(
            f"{variant:8s} predict {N_ROWS} rows: {together:.3f} s ({literal / together:.1f} times faster "
            f"than sample by sample); Jacobian {1e3 * jacobian:.1f} ms"
        )
    if options.json:
        options.json.write_text(json.dumps({"machine": platform.processor(), **numbers}, indent=2) + "\n")


if __name__ == "__main__":
    main()
