"""Simulations of a whole run within a budget, to 1.17 and 1.02 times the best known error.

Run `python tests/benchmarks/one_budget.py FOLDER [--cases office wall] [--seeds 5 6] [--budgets 64 100]`.
Each run is a `studies.run` in FOLDER and trains for 5 to 20 minutes on two cores, whatever the model costs.
A run that is there is not made again. A line per run: simulations used, the first ones at which the error was
at most so many times the best known, the last error over the best, the surrogate's cross-validated MAE, and
the calls of `studies.calibrate` without state equations beside it. Gates nothing.
"""

import argparse
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

TIMES = 1.17, 1.02


def simulations_to(history: list[tuple[int, float]], target: float) -> str:
    """Return the simulations at which an error was at most a target, "never" if it never was."""
    return next((str(n) for n, mse in history if mse <= target), "never")


def main() -> None:
    """Print a line per case, budget and seed."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("folder", type=Path)
    options.add_argument("--cases", nargs="+", default=["office"])
    options.add_argument("--seeds", nargs="+", type=int, default=[5, 6])
    options.add_argument("--budgets", nargs="+", type=int, default=[64, 100])
    chosen = options.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    os.chdir(chosen.folder)
    import studies

    for case in chosen.cases:
        for seed in chosen.seeds:
            search = studies.calibrate(case, seed=seed, state_equations=False)
            for budget in chosen.budgets:
                found = studies.run(case, seed=seed, simulations=budget)
                best = min(
                    [one.mse for one in found.task.case.references if one.is_target] + [found.mse, search.mse]
                )
                history, polished = list[tuple[int, float]](), 0
                for one in (calibration.outcome.result for calibration in found.calibrations):
                    paid = polished + one.history.n_calls
                    history += zip(paid.tolist(), one.history.best_mse.tolist(), strict=True)
                    polished += one.ledger["n_screen_checks"] + one.ledger["n_polish"] + one.n_repeated
                to = [simulations_to(history, times * best) for times in TIMES]
                beside = [str(search.outcome.result.history.calls_to(times * best)) for times in TIMES]
                mae = found.tuning.tuned.studies[-1].mae
                print(
                    f"{case} N = {budget} seed {seed}: {found.spent.used} used, {' / '.join(to)} to "
                    f"{' / '.join(map(str, TIMES))} times the best, {found.mse / best:.3f} times at the end, "
                    f"CV MAE {mae:.3g}; calibrate {' / '.join(beside)}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
