"""How long a training takes on the processor and on a CUDA device, and whether both err alike.

Run `python tests/benchmarks/device_speed.py [--sizes 32 512 4096] [--variants refined pca-gp]`. Each training
is one of `pelsvae.fit` on the office room, without a search, beside 10,000 predictions. Wall-clock times; the
first training on a device, which loads its kernels, is repeated. Prints; gates nothing.
"""

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

import torch  # noqa: E402
from surrogate_rivals.problems import PROBLEMS, Sets, simulated  # noqa: E402

from pelsvae.config import VARIANTS, Device  # noqa: E402
from pelsvae.metrics import errors  # noqa: E402
from pelsvae.training import fit  # noqa: E402
from simulation import uniform_design  # noqa: E402


def measured(sets: Sets, variant: str, n: int, device: Device) -> str:
    """Train on the first n rows; return seconds of training, of predictions, and the mean absolute error."""
    data = sets.learnt.first(n)
    started = time.perf_counter()
    surrogate = fit(
        data.theta,
        data.y,
        data.validation,
        config=VARIANTS[variant].replace(device=device),
        seed=0,
        log_columns=data.space.is_log,
        output_scales=data.output_scales,
    ).surrogate
    train_s = time.perf_counter() - started
    theta, y = sets.test
    found = errors(surrogate.predict(theta), y, data.output_scales)
    many = uniform_design(data.space, 10_000, 777)
    started = time.perf_counter()
    surrogate.predict(many)
    return f"{train_s:.2f} s | {time.perf_counter() - started:.3f} s | {found.mae:.4f} {sets.unit}"


def main() -> None:
    """Measure every variant, size and device, and print a row of a table for each."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--sizes", type=int, nargs="+", default=(32, 512, 4096), metavar="N")
    made.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="VARIANT")
    options = made.parse_args()
    devices: list[Device] = ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]
    kept = ROOT / "mlruns" / "benchmarks" / "device_speed"
    sets = simulated(PROBLEMS["office"], 0, max(options.sizes), kept)
    print(
        f"{torch.get_num_threads()} threads; " + (torch.cuda.get_device_name() if devices[1:] else "no CUDA")
    )
    print("| surrogate | rows | device | training | 10,000 predictions | mean absolute error |")
    print("|---|---:|---|---:|---:|---:|")
    for variant in options.variants:
        for n in options.sizes:
            for device in devices:
                if device == "cuda" and n == options.sizes[0]:
                    measured(sets, variant, n, device)
                print(f"| {variant} | {n} | {device} | {measured(sets, variant, n, device)} |", flush=True)


if __name__ == "__main__":
    main()
