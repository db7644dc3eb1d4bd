"""Time the surrogate: training per size, epochs, predictions of 10,000 rows, Jacobian.

Run as `python tests/benchmarks/surrogate_speed.py [--json FILE]`; prints ratios within one run and gates
nothing. Times are CPU seconds, which other work on the machine disturbs least. `--against CHECKOUT` times the
default form in turns with another version's, whose repository lies there.
The data is a sum of closed-form RC steps in the office's size: 14 parameters, 481 times.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from pelsvae.config import VARIANTS, SurrogateConfig
from pelsvae.linear_vae import LinearVae
from pelsvae.network import PelsVae, latent_samples
from pelsvae.surrogate import Surrogate
from pelsvae.training import fit

N_PARAMETERS, N_TIMES, N_ROWS = 14, 481, 10_000
SIZES = (32, 64, 128, 256)
PROCESS_SIZES = (64, 256, 1024, 4096)


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


def wall_seconds(function: Callable[[], object], n_repeats: int = 5) -> float:
    """Return the median wall time of a call, other programs' share included."""
    taken = []
    for _ in range(n_repeats):
        start = time.perf_counter()
        function()
        taken.append(time.perf_counter() - start)
    return float(np.median(taken))


def predict_sample_by_sample(surrogate: Surrogate, theta: npt.NDArray[np.float64]) -> None:
    """Do what Eq. 7 says literally: decode each of the L samples in full, then average."""
    features = surrogate.theta_standardizer.features(torch.from_numpy(theta), torch.float32)
    network = surrogate.network
    assert isinstance(network, PelsVae)
    with torch.inference_mode():
        mean, log_variance = network.regressor(features)
        total = torch.zeros(len(theta), N_TIMES)
        for eps in surrogate.eps:
            total += network.decoder(latent_samples(mean, log_variance, eps[None, None, :]), features)


def predict_as_in_the_textbook(surrogate: Surrogate, theta: npt.NDArray[np.float64]) -> None:
    """Multiply every member's whole covariances with its coefficients, the polynomial's part included."""
    network = surrogate.network
    assert isinstance(network, LinearVae)
    features = surrogate.theta_standardizer.features(torch.from_numpy(theta), torch.float64)
    with torch.inference_mode():
        for start in range(0, len(theta), 128):
            rows = features[start : start + 128]
            codes = torch.zeros(len(rows), len(network.basis), dtype=torch.float64)
            for hyper, share, coefficients in zip(
                network.hyper, network.share, network.coefficients, strict=True
            ):
                codes += share * (network.kernel.matrix(hyper, rows, network.x) @ coefficients)
            network.decoder(codes)


def timed_fit(config: SurrogateConfig, n: int, n_threads: int) -> tuple[Surrogate, float, float]:
    """Fit n rows; return the surrogate, CPU seconds and seconds."""
    config = config.replace(device="cpu", n_threads=n_threads)
    rows, validation = data(n, seed=0), data(320, seed=1)
    start, start_wall = time.process_time(), time.perf_counter()
    surrogate = fit(*rows, validation, config=config, seed=0).surrogate
    return surrogate, time.process_time() - start, time.perf_counter() - start_wall


def once(n: int) -> dict[str, float]:
    """Time one fit of n rows and its predictions. CPU seconds."""
    surrogate, spent, _ = timed_fit(VARIANTS["pca-gp"], n, n_threads=1)
    theta, _ = data(N_ROWS, seed=2)
    predicted = seconds(lambda: surrogate.predict(theta), n_repeats=5)
    spread = seconds(lambda: surrogate.deviation(theta[:1000]), n_repeats=3)
    return {"fit": spent, "10,000 predictions": predicted, "1,000 deviations": spread}


def against(checkout: Path) -> None:
    """Time another version and this one in turns, each in a process of its own, and print ratios."""
    for n in PROCESS_SIZES:
        known = []
        for root in (checkout, Path(__file__).parents[2]):
            process = subprocess.run(
                [sys.executable, __file__, "--once", str(n)],
                env={**os.environ, "PYTHONPATH": str(root.resolve())},
                stdout=subprocess.PIPE,
                check=True,
                text=True,
            )
            known.append(json.loads(process.stdout))
        before, now = known
        parts = [f"{what} {now[what]:.2f} s, {now[what] / before[what]:.2f} times" for what in now]
        print(f"n = {n:4d}, this version and its part of the other's time: {'; '.join(parts)}", flush=True)


def processes(config: SurrogateConfig) -> dict[str, float]:
    """Time fits and predictions of the form with Gaussian processes."""
    numbers: dict[str, float] = {}
    theta, _ = data(N_ROWS, seed=2)
    for n in PROCESS_SIZES:
        _, _, on_two = timed_fit(config, n, n_threads=2)
        surrogate, spent, _ = timed_fit(config, n, n_threads=1)
        alone = seconds(lambda s=surrogate: s.predict(theta), n_repeats=2)  # type: ignore[misc]
        textbook = seconds(lambda s=surrogate: predict_as_in_the_textbook(s, theta), n_repeats=2)  # type: ignore[misc]
        two = wall_seconds(lambda s=surrogate: s.predict(theta, n_jobs=2))  # type: ignore[misc]
        numbers |= {
            f"gaussian-process n={n} fit_s": spent,
            f"gaussian-process n={n} fit_two_threads_wall_s": on_two,
            f"gaussian-process n={n} predict_10000_s": alone,
            f"gaussian-process n={n} predict_10000_two_cores_wall_s": two,
            f"gaussian-process n={n} predict_10000_textbook_over_ours": textbook / alone,
        }
        print(
            f"gaussian-process n = {n:4d}: fitted in {spent:5.1f} s, on two threads {on_two:.1f} s of "
            f"wall time; predict "
            f"{N_ROWS} rows: {alone:.3f} s ({textbook / alone:.1f} x faster than by whole covariances), "
            f"on two cores {two:.3f} s of wall time"
        )
    return numbers


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--threads", type=int, default=1, help="CPU threads of torch (default 1)")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="another version, timed in turns")
    parser.add_argument("--once", type=int, metavar="N", help="only a fit of N rows, as JSON")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    if options.once:
        print(json.dumps(once(options.once)))
        return
    if options.against:
        against(options.against)
        return
    numbers: dict[str, float] = {}
    validation = data(320, seed=1)
    for variant, config in VARIANTS.items():
        if config.regressor == "gaussian-process":
            numbers |= processes(config)
            continue
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
