"""What a polish costs that the surrogate leads, beside least squares from the same screened point.

Run `python tests/benchmarks/surrogate_polish.py [--problems NAME ...] [--sizes 16 32 64 128 512] [--seeds 5]
[--kept FOLDER]`. For each problem, size and seed a surrogate of the first training rows is trained without a
validation set, differential evolution screens the box on it, and both polish from there: `SurrogateSearch`,
which knows the training rows, and `LeastSquaresTRF` as the profile `quick` sets it. "SurrogateSearch, rows
alone" knows the training rows without the surrogate. Calls are those of the polish, counted at the model.
Errors are compared with the best that `data/benchmarks/fewest_calls.json` knows. In FOLDER surrogates and
finished pairs are kept, so that an interrupted benchmark goes on. Prints a line per pair, then medians, and
gates nothing. A pair takes one to two minutes of processor time, most of it the training.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(Path(__file__).parent)]

from fewest_calls.kept import Kept  # noqa: E402
from fewest_calls.problems import posed, problems  # noqa: E402

from pelsvae.config import VARIANTS  # noqa: E402
from pelsvae.surrogate import Surrogate  # noqa: E402
from pelsvae.surrogate_files import DESCRIPTION, load_surrogate, save_surrogate  # noqa: E402
from pelsvae.training import fit  # noqa: E402
from simulation.case import Case  # noqa: E402
from simulation.design import uniform_design  # noqa: E402
from simulation.trajectories import Trajectories  # noqa: E402
from studies.calibration.hidden_network.inputs import drive_of  # noqa: E402
from studies.calibration.optimizers import SurrogateSearch  # noqa: E402
from studies.calibration.polish import LeastSquaresTRF  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.calibration.recorder import SearchResult  # noqa: E402
from studies.calibration.screen import DifferentialEvolution  # noqa: E402
from studies.stages.simulate_stage import train_seed  # noqa: E402
from studies.surrogate_model import SurrogateModel  # noqa: E402

OURS, ALONE, LEAST_SQUARES = "SurrogateSearch", "SurrogateSearch, rows alone", "LeastSquaresTRF"
TIMES_BEST = 1.17, 1.02
# Most calls of a polish: of least squares as in the profile `quick`.
MOST, MOST_LEAST_SQUARES = 100, 300
NEVER = float("inf")

Pair = dict[str, Any]


def trained(case: Case, rows: Trajectories, seed: int, folder: Path | None) -> Surrogate:
    """Return the surrogate of training rows, the kept one where there is one."""
    if folder is not None and (folder / DESCRIPTION).is_file():
        return load_surrogate(folder)
    good, drive = ~rows.failed, drive_of(case)
    variant = "pca-gp" if drive is None else "state-space"
    surrogate = fit(
        rows.theta[good],
        rows.y[good],
        None,
        config=VARIANTS[variant].replace(n_threads=1),
        seed=seed,
        log_columns=np.array(case.parameter_space.is_log),
        output_scales=np.array(case.measurement.error_scales),
        drive=drive,
    ).surrogate
    if folder is not None:
        save_surrogate(surrogate, folder)
    return surrogate


def polished(case: Case, problem: CalibrationProblem, n: int, seed: int, folder: Path | None) -> Pair:
    """Screen a surrogate of n training rows, and polish in each way."""
    space, measurement = case.parameter_space, case.measurement
    rows = problem.model.simulate(uniform_design(space, n, train_seed(seed)))
    model = SurrogateModel(
        trained(case, rows, seed, folder), space, measurement.output_names, measurement.time
    )
    cheap = problem.on(model)
    screened = DifferentialEvolution(popsize=8, maxiter=200, margin=0.2).minimize(cheap, seed=seed).u
    first = problem.evaluate(screened)
    known = problem.judge(space.to_unit(rows.theta), rows).joined(first)
    led = SurrogateSearch(max_calls=MOST)
    least = LeastSquaresTRF(max_calls=MOST_LEAST_SQUARES, ftol=1e-4)
    ways: dict[str, Callable[[], SearchResult]] = {
        OURS: lambda: led.minimize(problem, screened, known=known, surrogate=cheap, seed=seed),
        ALONE: lambda: led.minimize(problem, screened, known=known, seed=seed),
        LEAST_SQUARES: lambda: least.minimize(problem, screened, known=first),
    }
    pair: Pair = {"screened": float(first.mse[0])}
    for name, polish in ways.items():
        began = time.process_time()
        found = polish()
        pair[name] = {
            "calls": found.history.n_calls.tolist(),
            "mse": found.history.best_mse.tolist(),
            "n_calls": found.n_calls,
            "converged": found.converged,
            "seconds": round(time.process_time() - began, 1),
        }
    return pair


def calls_to(run: Pair, error: float) -> float:
    """Return the calls to an error, infinite where a polish did not come to it."""
    return min((n for n, mse in zip(run["calls"], run["mse"], strict=True) if mse <= error), default=NEVER)


def error_at(run: Pair, n_calls: int) -> float:
    """Return the best error within so many calls."""
    within = [mse for n, mse in zip(run["calls"], run["mse"], strict=True) if n <= n_calls]
    return min(within, default=NEVER)


def is_within(pair: Pair, n_calls: int) -> bool:
    """Return whether ours is at most 1.02 times as far as least squares after so many calls."""
    return error_at(pair[OURS], n_calls) <= 1.02 * error_at(pair[LEAST_SQUARES], n_calls)


def shown_count(value: float) -> str:
    """Say a number of calls."""
    return "never" if value == NEVER else f"{value:g}"


def shown(values: list[float]) -> str:
    """Say median and worst."""
    return f"{shown_count(statistics.median(values))} ({shown_count(max(values))})"


def said(name: str, run: Pair, best: float) -> str:
    """Return a polish in words: its calls to both errors, and in all."""
    reached = " ".join(shown_count(calls_to(run, factor * best)) for factor in TIMES_BEST)
    return f"{name} {reached} of {run['n_calls']}"


def summary(pairs: list[Pair], best: float) -> list[str]:
    """Return medians of the calls by way, and how often ours is worse than least squares at equal calls."""
    lines = []
    for name in (OURS, ALONE, LEAST_SQUARES):
        runs = [pair[name] for pair in pairs]
        cells = [shown([calls_to(run, factor * best) for run in runs]) for factor in TIMES_BEST]
        cells.append(shown([run["n_calls"] for run in runs]))
        seconds = statistics.median(run["seconds"] for run in runs)
        lines.append(f"| {name} | {' | '.join(cells)} | {seconds:g} |")
    # At each call up to the end of ours, and at that end.
    ends = [pair[OURS]["n_calls"] for pair in pairs]
    n_within = sum(is_within(pair, n) for pair, n in zip(pairs, ends, strict=True))
    n_always = sum(
        all(is_within(pair, k) for k in range(1, n + 1)) for pair, n in zip(pairs, ends, strict=True)
    )
    lines.append(
        f"within 1.02 times least squares at equal calls: {n_within} of {len(pairs)} pairs at the end, "
        f"{n_always} at every call"
    )
    return lines


def main() -> None:
    """Polish what is asked for, and print a line per pair and a table per problem."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", nargs="+", default=["office, days 0-10"])
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 32, 64, 128, 512])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--kept", type=Path, help="folder of surrogates and finished pairs")
    options = parser.parse_args()
    kept = Kept(ROOT / "data" / "benchmarks" / "fewest_calls.json")
    for entry in problems([]):
        if entry.name not in options.problems:
            continue
        best, case, pairs = kept.problems[entry.name].best, entry.make().case, list[Pair]()
        with posed(case) as problem:
            for seed in options.seeds:
                for n in options.sizes:
                    folder = options.kept and options.kept / f"{entry.name}, {n} rows, seed {seed}"
                    file = folder and folder / "pair.json"
                    if file is not None and file.is_file():
                        pair = json.loads(file.read_text(encoding="utf-8"))
                    else:
                        pair = polished(case, problem, n, seed, folder)
                        if file is not None:
                            file.write_text(json.dumps(pair), encoding="utf-8")
                    pairs.append(pair)
                    cells = [said(name, pair[name], best) for name in (OURS, ALONE, LEAST_SQUARES)]
                    there = f"{pair['screened'] / best:.2f} times the best error"
                    print(f"{entry.name}, n = {n}, seed {seed}: {there}; {'; '.join(cells)}", flush=True)
        print("\n| polish | calls to 1.17 times | to 1.02 times | in all | s |\n|---|---:|---:|---:|---:|")
        print("\n".join(summary(pairs, best)), flush=True)


if __name__ == "__main__":
    main()
