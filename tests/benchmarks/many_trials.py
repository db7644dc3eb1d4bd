"""How long `studies status` and `studies best` take in a project with many trials; prints seconds.

python tests/benchmarks/many_trials.py [--trials 2000] [--sizes 5]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "cli")]

from studies_for_tests import declared, declared_baseline, ended_trial, write_study  # noqa: E402


def main() -> None:
    """Write a project without a training and time both commands, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--sizes", type=int, default=5)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
        (root / "mlruns").mkdir()
        random = np.random.default_rng(0)
        for size in range(chosen.sizes):
            n_train = 32 << size
            study = write_study(root, declared("office-quick", n_train), n_trials=0, n_planned=chosen.trials)
            n = chosen.trials // chosen.sizes
            study.add_trials(
                ended_trial(declared("office-quick", n_train), k, float(random.gamma(4.0)) / n_train**0.5)
                for k in range(n)
            )
            write_study(root, declared_baseline("office-quick", n_train), n_trials=1)
        for command in ("status", "best"):
            words = [sys.executable, "-m", "studies", command]
            took = []
            for _ in range(3):
                began = time.perf_counter()
                environment = {**os.environ, "PYTHONPATH": str(ROOT)}
                subprocess.run(words, cwd=root, env=environment, check=True, capture_output=True)
                took.append(time.perf_counter() - began)
            print(f"{chosen.trials} trials, {command}: {min(took):.2f} s (best of {len(took)})")


if __name__ == "__main__":
    main()
