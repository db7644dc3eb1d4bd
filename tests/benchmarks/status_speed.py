"""How long `studies status` takes to list 2,000 trials, from the shell's prompt to the last line.

Tells Optuna of 50 studies of 40 made-up trials in a temporary project, then types commands in new processes
and prints wall times. Type:

    python tests/benchmarks/status_speed.py
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests" / "cli")]
N_LABELS, SIZES, N_TRIALS, N_RUNS = 10, (32, 64, 128, 256, 512), 40, 7
LIMIT_S = 2.0


def main() -> None:
    from studies_for_tests import declared, write_study

    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        for number in range(N_LABELS):
            for n_train in SIZES:
                spec = declared(f"office-made-seed{number}", n_train, seed=number)
                write_study(root, spec, n_trials=N_TRIALS)
        n = N_LABELS * len(SIZES) * N_TRIALS
        print(f"{n} trials in {N_LABELS * len(SIZES)} studies")
        for words in (["status"], ["status", "office-made-seed3"], ["status", "--json"], ["best"]):
            timed = [_timed(root, words) for _ in range(N_RUNS)]
            walls, busy = sorted(wall for wall, _ in timed), statistics.median(cpu for _, cpu in timed)
            print(
                f"studies {' '.join(words):26} median {statistics.median(walls):.2f} s "
                f"({busy:.2f} s of them busy), slowest of {N_RUNS}: {walls[-1]:.2f} s (limit {LIMIT_S:g} s)"
            )


def _timed(root: Path, words: list[str]) -> tuple[float, float]:
    """Return wall time and processor time of a command. [s]."""
    program = [sys.executable, "-m", "studies", *words]
    environment = os.environ | {"STUDIES_ROOT": str(root), "PYTHONPATH": str(REPOSITORY)}
    started, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(program, env=environment, check=True, capture_output=True, cwd=root)
    wall_s, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
