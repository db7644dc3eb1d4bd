"""Results that a change of structure must not change: `python tests/benchmarks/golden_results.py`.

For every embedded case whose files are here: digests of the case and of simulated rows (2,000 of the office,
200 of the others, in one process and in two), and what `studies calibrate` ends with for the seeds 0 to 2.
Compares them with `data/benchmarks/golden_results.json` and exits 1 where one differs; `--write` replaces
that file. Last digits depend on the machine: on another one, write first and compare afterwards.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

from simulation import Case, InputError, PoolModel, load_case, uniform_design  # noqa: E402
from studies.embedded import EMBEDDED, case_files  # noqa: E402

FILE = ROOT / "data" / "benchmarks" / "golden_results.json"
N_ROWS = {"office": 2000}
SEEDS = (0, 1, 2)


def rows_of(case: Case, n_rows: int) -> dict[str, str]:
    """Return digests of what a uniform design of this case answers, in one process and in two."""
    # Of several experiments the first one's rows stand for all.
    with case.open_model() as alone:
        theta = uniform_design(alone.parameter_space, n_rows, seed=0)
        answer = alone.simulate(theta)
    with PoolModel(case.settings.open, 2) as shared:
        in_two = shared.simulate(theta)
    return {
        "case": case.digest,
        "model": case.model_digest,
        "rows": hashlib.sha256(answer.y.tobytes()).hexdigest(),
        "rows_in_two_processes": hashlib.sha256(in_two.y.tobytes()).hexdigest(),
        "failures": hashlib.sha256("\n".join(answer.failures).encode()).hexdigest(),
        "n_failed": str(sum(map(bool, answer.failures))),
    }


def calibrated(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Return theta, error, calls and verdict of `studies calibrate`."""
    command = (sys.executable, "-P", "-m", "studies", "calibrate", name, "--json", "-q", "--seed", str(seed))
    # The case's own seed, window and budget: what a user types.
    said = subprocess.run(
        command,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    found = json.loads(said.stdout)["stages"][0]
    return {key: found[key] for key in ("digest", "theta", "mse", "n_rounds", "stop_reason", "converged")}


def all_results() -> dict[str, Any]:
    """Return everything that is compared, by case."""
    found: dict[str, Any] = {}
    for name, file in case_files(EMBEDDED / "fmus").items():
        try:
            case = load_case(file)
        except InputError as error:
            print(f"{name}: not here ({error})", flush=True)
            continue
        found[name] = rows_of(case, N_ROWS.get(name, 200))
        with tempfile.TemporaryDirectory(prefix="golden-") as folder:
            for seed in SEEDS:
                found[name][f"calibrate, seed {seed}"] = calibrated(name, seed, Path(folder))
                print(name, seed, found[name][f"calibrate, seed {seed}"]["mse"], flush=True)
    return found


def differences(before: Any, after: Any, at: str = "") -> list[str]:
    """Return one line for each value that is not the same."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = sorted({*before, *after})
        return [line for key in keys for line in differences(before.get(key), after.get(key), f"{at}/{key}")]
    return [] if before == after else [f"{at}: {before} -> {after}"]


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="replace the golden file")
    found = json.loads(json.dumps(all_results()))
    if parser.parse_args().write:
        FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        return 0
    changed = differences(json.loads(FILE.read_text(encoding="utf-8")), found)
    print("\n".join(changed) or f"{len(found)} cases: all as before")
    return bool(changed)


if __name__ == "__main__":
    sys.exit(main())
