"""How long `studies status` and `studies best` take in a project with many trials; prints seconds.

Both of the clock and of the processor, which says more where other programs run.

python tests/benchmarks/many_trials.py [--trials 2000] [--sizes 5]
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from optuna.distributions import FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "cli")]

from studies_for_tests import MAX_EPOCHS, declared, declared_baseline, ended_trial, write_study  # noqa: E402

N_REPORTS = 16
MORE = {
    "n_layers": IntDistribution(2, 8),
    "learning_rate": FloatDistribution(1e-4, 1e-2, log=True),
    "sparsity": FloatDistribution(0.1, 3.0, log=True),
}


def as_trained(trial: FrozenTrial) -> FrozenTrial:
    """Add what a worker writes of a trial of the profile `quick`: 31 rows of Optuna's tables."""
    error = trial.intermediate_values[MAX_EPOCHS]
    epochs = np.geomspace(0.1 * MAX_EPOCHS, MAX_EPOCHS, N_REPORTS).round().astype(int)
    trial.intermediate_values = {int(epoch): error for epoch in epochs}
    trial.params |= {"n_layers": 4, "learning_rate": 3e-3, "sparsity": 1.0}
    trial.distributions |= MORE
    owner = {"trial": 0, "machine": "vm/pid:[4026531836]", "pid": 7000, "started_s": 1.8e9}
    trial.user_attrs |= {"owner": owner, "seed": 1, "reason": "max_epochs"}
    trial.user_attrs |= {"val/unexplained": 0.2, "test/unexplained": 0.3}
    return trial


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
                as_trained(
                    ended_trial(declared("office-quick", n_train), k, float(random.gamma(4.0)) / n_train**0.5)
                )
                for k in range(n)
            )
            write_study(root, declared_baseline("office-quick", n_train), n_trials=1)
        for command in ("status", "best"):
            words = [sys.executable, "-m", "studies", command]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package is compiled
            took, computed = [], []
            for _ in range(4):
                began, before = time.perf_counter(), _processor_s()
                subprocess.run(words, cwd=root, env=environment, check=True, capture_output=True)
                took.append(time.perf_counter() - began)
                computed.append(_processor_s() - before)
            used = f"{min(took):.2f} s, of the processor {min(computed):.2f} s"
            print(f"{chosen.trials} trials, {command}: {used} (best of {len(took)})")


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
