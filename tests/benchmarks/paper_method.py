"""What the paper's method costs: whole studies over several seeds, model calls to a target, medians.

Run `python tests/benchmarks/paper_method.py [CASE] [--target 0.0121] [--calls 200] [--seeds 0 1 2 3 4]`.
Every seed is a study of its own (designs, trainings, screening); finished ones are read, not repeated. Calls
are counted at the FMU as the paper counts them: training, screening check, polish. Prints; gates nothing.
"""

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
NEVER = float("inf")


def study(case: str, seed: int, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Run one study and return its calibrations."""
    sizes = [str(n_train) for n_train in options.n_train]
    command = [
        sys.executable,
        "-m",
        "studies",
        "run",
        case,
        "--profile",
        options.profile,
        "--seed",
        str(seed),
    ]
    done = subprocess.run(
        [*command, "--n-train", *sizes, "--json", "--quiet"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed: {done.stdout.strip()}")
    stages = json.loads(done.stdout)["stages"]
    return [stage for stage in stages if stage["stage"].startswith("calibrate-")]


def row(seed: int, calibration: dict[str, Any], target: float, calls: int) -> dict[str, Any]:
    """Read one calibration: where it stood after so many calls, and when it arrived."""
    with np.load((ROOT / calibration["file"]).with_suffix(".npz"), allow_pickle=False) as arrays:
        paid = [*zip(arrays["history_calls"].tolist(), arrays["history_mse"].tolist(), strict=True)]
    return {
        "n_train": calibration["n_train"],
        "seed": seed,
        "mae": calibration["screening"]["errors"]["test/mae"],
        "p90": calibration["screening"]["errors"]["test/p90"],
        "surrogate": calibration["screening"]["mse_surrogate"],
        "screened": calibration["screening"]["mse"],
        "at_calls": min((mse for n_calls, mse in paid if n_calls <= calls), default=NEVER),
        "to_target": min((n_calls for n_calls, mse in paid if mse <= target), default=NEVER),
        "final": calibration["mse"],
        "total": calibration["ledger"]["total_paper"],
        "honest": calibration["ledger"]["total_calls"],
    }


def main() -> None:
    """Run the studies and print a line per calibration and a median per size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", nargs="?", default="office-recorded")
    parser.add_argument("--profile", default="quick")
    parser.add_argument("--target", type=float, default=0.0121, help="MSE to arrive at [K²]")
    parser.add_argument("--calls", type=int, default=200, help="calls after which the MSE is read")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--n-train", type=int, nargs="+", default=[32, 64])
    options = parser.parse_args()
    rows = [
        row(seed, calibration, options.target, options.calls)
        for seed in options.seeds
        for calibration in study(options.case, seed, options)
    ]
    heads = ["n", "seed", "MAE", "P90", "surrogate", "screened", f"at {options.calls}"]
    heads += [f"calls to {options.target:g}", "final", "calls", "all calls"]
    print(" | ".join(heads))
    for n_train in options.n_train:
        of_size = [entry for entry in rows if entry["n_train"] == n_train]
        for entry in of_size:
            print(
                " | ".join(
                    f"{value:.4g}" if isinstance(value, float) else f"{value}" for value in entry.values()
                )
            )
        medians = {key: statistics.median(entry[key] for entry in of_size) for key in list(of_size[0])[2:]}
        print(" | ".join([str(n_train), "median", *(f"{value:.4g}" for value in medians.values())]))


if __name__ == "__main__":
    main()
