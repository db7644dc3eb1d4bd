"""How many model calls calibrations need from no initial guess: ours and its peers, everything counted.

Run `python tests/benchmarks/fewest_calls.py [--methods adaptive broyden] [--seeds 10] [--instances 0 1 2]`.
Problems: the recorded office where its data lie and the virtual one, three windows each, and seeded instances
(office_instances.py). Targets are multiples of the best error that brute force finds. Every run is kept in
the JSON file as soon as it ends and not repeated; prints a table and gates nothing.
"""

import argparse
import json
import statistics
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from office_instances import WINDOWS_D, make_instance  # noqa: E402
from peers import Method, adaptive, broyden, dfols, trf  # noqa: E402

from simulation.case import Case, load_case  # noqa: E402
from studies.calibration import CalibrationProblem, best_known  # noqa: E402

METHODS: dict[str, Method] = {
    "adaptive": adaptive(),
    "adaptive, 2 parallel": adaptive(n_parallel=2),
    "adaptive, 4 parallel": adaptive(n_parallel=4),
    "adaptive, 8 parallel": adaptive(n_parallel=8),
    "broyden": broyden,
    "trf": trf,
    "dfols": dfols,
}
FACTORS = (1.17, 1.05, 1.02)
NEVER = float("inf")


def cases(instances: list[int]) -> Iterator[tuple[str, Case]]:
    """Yield the problems' names and cases."""
    recorded = (ROOT / "data" / "office-recorded" / "recording_1800s.csv").is_file()
    for name in ("office-recorded", "office") if recorded else ("office",):
        for window_d in WINDOWS_D:
            case = load_case(ROOT / "fmus" / name, window_d=window_d)
            yield f"{name}, days {window_d[0]:g}-{window_d[1]:g}", case
    for seed in instances:
        instance = make_instance(seed)
        yield instance.name, instance.case


class Kept:
    """Numbers in a JSON file that is rewritten after every run."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.values: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}

    def put(self, key: str, value: Any) -> None:
        """Keep one value, on disk at once."""
        self.values[key] = value
        self._path.parent.mkdir(parents=True, exist_ok=True)
        part = self._path.with_suffix(".part")
        part.write_text(json.dumps(self.values, indent=0) + "\n")
        part.replace(self._path)


@contextmanager
def posed(case: Case) -> Iterator[CalibrationProblem]:
    """Open a case's model and pose its problem."""
    with case.open_model() as model:
        yield CalibrationProblem(model, case.measurement)


def measure(kept: Kept, name: str, case: Case, options: argparse.Namespace) -> None:
    """Run what is missing of one problem."""
    with posed(case) as problem:
        if f"{name} | best" not in kept.values:
            kept.put(f"{name} | best", best_known(problem, options.brute_force).best.mse)
        best = kept.values[f"{name} | best"]
        for method in options.methods:
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                key = f"{name} | {method} | {seed}"
                if key not in kept.values:
                    history = METHODS[method](problem, seed, options.max_calls, FACTORS[-1] * best)
                    kept.put(key, {str(factor): history.calls_to(factor * best) for factor in FACTORS})


def line(kept: Kept, name: str, method: str, options: argparse.Namespace) -> list[list[float]]:
    """Print one row of the table; return the calls to each factor, one list per factor."""
    runs = [
        kept.values[f"{name} | {method} | {seed}"]
        for seed in range(options.first_seed, options.first_seed + options.seeds)
    ]
    calls = [[NEVER if run[str(f)] is None else run[str(f)] for run in runs] for f in FACTORS]
    cells = [f"{statistics.median(of_factor):g} ({max(of_factor):g})" for of_factor in calls]
    print(f"| {name} | {method} | {kept.values[f'{name} | best']:.5f} | " + " | ".join(cells) + " |")
    return calls


def main() -> None:
    """Read the options, measure what is missing, print all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["adaptive", "broyden", "trf"])
    parser.add_argument("--seeds", type=int, default=10, help="runs of each method on each problem")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--instances", type=int, nargs="*", default=[0, 1, 2, 3, 4])
    parser.add_argument("--max-calls", type=int, default=300, help="budget of each run")
    parser.add_argument("--brute-force", type=int, default=24, metavar="N", help="starts for the best error")
    parser.add_argument("--json", type=Path, default=ROOT / "mlruns" / "benchmarks" / "fewest_calls.json")
    options = parser.parse_args()
    kept = Kept(options.json)
    names = []
    for name, case in cases(options.instances):
        measure(kept, name, case, options)
        names.append(name)
    heads = [f"calls to {factor:g} x best, median (worst)" for factor in FACTORS]
    print("| problem | method | best MSE | " + " | ".join(heads) + " |")
    print("|---" * (3 + len(FACTORS)) + "|")
    for method in options.methods:
        all_calls = [line(kept, name, method, options) for name in names]
        pooled = [[call for calls in all_calls for call in calls[i]] for i in range(len(FACTORS))]
        cells = [f"{statistics.median(of_factor):g} ({max(of_factor):g})" for of_factor in pooled]
        print(f"| all | {method} | | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
