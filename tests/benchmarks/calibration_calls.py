"""How many model calls LS-TRF needs from random starts, and the best error by brute force.

Run `python tests/benchmarks/calibration_calls.py [CASE] [--window 0 10] [--starts 20] [--json FILE]`.
CASE is a case's folder or file; the default is fmus/office-recorded where its data lie, else fmus/office.
Prints medians and every start; gates nothing.
"""

import argparse
import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from multistart_for_tests import MultistartResult, best_known, multistart  # noqa: E402

from simulation import load_case  # noqa: E402
from studies.calibration.polish import LeastSquaresTRF  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402

FACTORS = (1.17, 1.02)
METHODS = {
    "signed, declared coordinates": LeastSquaresTRF(ftol=1e-9),
    "squared, linear coordinates (the paper's)": LeastSquaresTRF(ftol=1e-9, residuals="squared"),
}


def median_calls(calls: list[int | None]) -> float | None:
    """Return the median, None when half of the starts never arrived."""
    median = statistics.median([float("inf") if call is None else call for call in calls])
    return None if median == float("inf") else median


def default_case() -> Path:
    """Return the recorded office where its data lie, else the office that is shipped."""
    recorded = ROOT / "data" / "office-recorded" / "recording_1800s.csv"
    return ROOT / "fmus" / ("office-recorded" if recorded.is_file() else "office")


def brute_force(problem: CalibrationProblem, n_starts: int, seed: int) -> MultistartResult:
    """Find the best known error and say how many starts ended there."""
    found = best_known(problem, n_starts, seed)
    near = int((found.mse <= 1.005 * found.best.mse).sum())
    print(
        f"best known MSE {found.best.mse:.5f}; {near} of {n_starts} starts end there; {found.n_calls} calls"
    )
    return found


def measure(problem: CalibrationProblem, best_mse: float, arguments: argparse.Namespace) -> dict[str, Any]:
    """Count the calls of every method from the same random starts."""
    table: dict[str, Any] = {}
    for name, settings in METHODS.items():
        limited = replace(settings, max_calls=arguments.max_calls)
        runs = multistart(problem, arguments.starts, arguments.seed, polishing=limited)
        table[name] = {
            "final_mse": runs.mse.tolist(),
            "calls_to": {str(factor): runs.calls_to(factor * best_mse) for factor in FACTORS},
        }
        medians = {f: median_calls(runs.calls_to(f * best_mse)) for f in FACTORS}
        print(
            f"{name}: "
            + ", ".join(f"{median or 'never'} calls to {f} x best" for f, median in medians.items())
        )
    return table


def main() -> None:
    """Read the options, measure, print, keep."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", nargs="?", type=Path, default=default_case())
    parser.add_argument(
        "--window", nargs=2, type=float, metavar=("FROM", "TO"), help="days; default: the case's"
    )
    parser.add_argument("--starts", type=int, default=20, help="random starts of each method")
    parser.add_argument("--brute-force", type=int, default=24, metavar="N", help="starts of the brute force")
    parser.add_argument("--max-calls", type=int, default=2000, help="budget of each start")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="keep the numbers in this file")
    arguments = parser.parse_args()
    case = load_case(arguments.case, window_d=tuple(arguments.window) if arguments.window else None)
    started = time.perf_counter()
    with case.open_model() as model:
        problem = CalibrationProblem(model, case.measurement)
        print(f"{case.title}, days {case.window_d[0]:g} to {case.window_d[1]:g}")
        best = brute_force(problem, arguments.brute_force, arguments.seed)
        table = measure(problem, best.best.mse, arguments)
    document = {
        "case": case.name,
        "window_d": case.window_d,
        "seed": arguments.seed,
        "best_known_mse": best.best.mse,
        "brute_force_mse": best.mse.tolist(),
        "brute_force_calls": best.n_calls,
        "methods": table,
        "wall_s": time.perf_counter() - started,
    }
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
