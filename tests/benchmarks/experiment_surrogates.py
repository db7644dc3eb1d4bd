"""How a surrogate knows experiments: side by side, one surrogate for each, or the experiment as input.

Run `python tests/benchmarks/experiment_surrogates.py [office wall] [--experiments 4] [--sizes 64 256]`. A
recording is cut into experiments; n rows are simulated in each. "Side by side" is one surrogate whose outputs
are those of all experiments, as `studies run` trains it; "one each" trains one per experiment; "as input"
trains one with n rows of each and columns of 0 and 1 that say which. Prints mean and 90th percentile of
absolute errors over 320 test rows of all experiments, and seconds of training on one thread; gates nothing.
"""

import argparse
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

import numpy as np  # noqa: E402
from interval_coverage import in_experiments  # noqa: E402

from pelsvae.config import VARIANTS, SurrogateConfig  # noqa: E402
from pelsvae.metrics import errors  # noqa: E402
from pelsvae.training import fit  # noqa: E402
from simulation import uniform_design  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402

N_OTHER = 320
Sets = dict[str, tuple[FloatArray, list[FloatArray]]]
"""Parameters (n, p) and each experiment's outputs (n, t, k), by the name of the set."""


def simulated(name: str, n_experiments: int, days: float, n: int) -> Sets:
    """Simulate n training rows, and validation and test rows, in every experiment."""
    with tempfile.TemporaryDirectory() as folder:
        case = in_experiments(name, n_experiments, days, [], Path(folder))
    sets: Sets = {}
    for seed, (kind, rows) in enumerate((("train", n), ("validation", N_OTHER), ("test", N_OTHER))):
        theta = uniform_design(case.parameter_space, rows, seed)
        answers = []
        for one in case.experiments:
            with one.open_model() as model:
                answers.append(model.simulate(theta).y)
        sets[kind] = theta, answers
    return sets


def with_experiment(theta: FloatArray, answers: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the rows of all experiments with columns that say of which. Shapes (k n, p + k), (k n, t, l)."""
    k = len(answers)
    which = np.repeat(np.eye(k), len(theta), axis=0)
    return np.column_stack([np.tile(theta, (k, 1)), which]), np.concatenate(answers)


def predictions(way: str, sets: Sets, n: int, config: SurrogateConfig) -> tuple[list[FloatArray], float]:
    """Train in one way; return each experiment's predictions of the test rows, and the seconds it took."""
    theta, answers = sets["train"][0][:n], [y[:n] for y in sets["train"][1]]
    v_theta, v_answers = sets["validation"]
    test, k, began = sets["test"][0], len(answers), perf_counter()
    if way == "side by side":
        beside = fit(
            theta, np.concatenate(answers, axis=2), (v_theta, np.concatenate(v_answers, axis=2)),
            config=config, seed=0,
        )  # fmt: skip
        took_s = perf_counter() - began
        return np.split(beside.surrogate.predict(test), k, axis=2), took_s
    if way == "one each":
        own = [
            fit(theta, y, (v_theta, v_y), config=config, seed=0).surrogate
            for y, v_y in zip(answers, v_answers, strict=True)
        ]
        took_s = perf_counter() - began
        return [one.predict(test) for one in own], took_s
    one = fit(
        *with_experiment(theta, answers), with_experiment(v_theta, v_answers), config=config, seed=0
    ).surrogate
    took_s = perf_counter() - began
    return np.split(one.predict(with_experiment(test, answers)[0]), k), took_s


def main() -> None:
    """Train in every way and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", default=["office", "wall"])
    parser.add_argument("--experiments", type=int, default=4)
    parser.add_argument("--days", type=float, default=1.25)
    parser.add_argument("--sizes", type=int, nargs="*", default=[64, 256])
    parser.add_argument("--forms", nargs="*", default=["refined", "pca-gp"])
    options = parser.parse_args()
    print("| case | n | form | way | MAE | P90 | training [s] |\n|---|---:|---|---|---:|---:|---:|")
    for name in options.cases:
        sets = simulated(name, options.experiments, options.days, max(options.sizes))
        true = np.concatenate(sets["test"][1])
        for n in options.sizes:
            for form in options.forms:
                config = replace(VARIANTS[form], n_threads=1)
                for way in ("side by side", "one each", "as input"):
                    found, took_s = predictions(way, sets, n, config)
                    error = errors(np.concatenate(found), true)
                    cells = [name, str(n), form, way, f"{error.mae:.4g}", f"{error.p90:.4g}", f"{took_s:.0f}"]
                    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
