"""How well surrogates predict after n simulations, and how fast: ours and their rivals, same data.

    python tests/benchmarks/surrogate_rivals [--methods refined "pca + gp"] [--problems office wall]
        [--sizes 32 64] [--seeds 5] [--first-seed 0] [--json FILE] [--plot FILE] [--detail]
    python tests/benchmarks/surrogate_rivals --from FILE [FILE ...] [--plot FILE] [--detail]

A seed is a fresh training design and a fresh model. Every run is kept in the JSON file as soon as it ends and
not repeated; simulations are kept in a folder beside it. Everything runs on one thread. Prints tables in
Markdown and gates nothing. The rivals' packages: pip install -e '.[benchmark]'.
"""

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]
# Before the libraries that read them are loaded: times are those of one thread.
os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

import torch  # noqa: E402
from benchmark_console import say, with_packages  # noqa: E402

from surrogate_rivals.kept import Kept  # noqa: E402
from surrogate_rivals.measured import run_once  # noqa: E402
from surrogate_rivals.methods import METHODS  # noqa: E402
from surrogate_rivals.problems import PROBLEMS, simulated  # noqa: E402
from surrogate_rivals.table import lines  # noqa: E402

SIZES = (32, 64, 128, 256, 512, 1024, 2048, 4096)


def measure(kept: Kept, options: argparse.Namespace) -> None:
    """Run what is missing, seed by seed, so that every method has the first one early."""
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for problem in options.problems:
            missing = [
                (problem, method, size, seed)
                for size in options.sizes
                for method in options.methods
                if (problem, method, size, seed) not in kept and size <= METHODS[method].most_rows
            ]
            if not missing:
                continue
            n = max(key[2] for key in missing)
            sets = simulated(PROBLEMS[problem], seed, n, options.json.with_suffix(""))
            for key in missing:
                _, method, size, _ = key
                with warnings.catch_warnings():
                    # Rivals warn of what their own libraries do; it says nothing about their errors.
                    warnings.simplefilter("ignore")
                    run = run_once(METHODS[method].train, sets, size, seed)
                kept.put(key, sets.unit, run)
                say(f"{problem}, n = {size}, seed {seed}, {method}: MAE {run.mae:.4g}, {run.train_s:.1f} s")


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), metavar="METHOD")
    made.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), metavar="PROBLEM")
    made.add_argument("--sizes", type=int, nargs="+", default=SIZES, metavar="N", help="training rows")
    made.add_argument("--seeds", type=int, default=5, help="training designs per problem and size")
    made.add_argument("--first-seed", type=int, default=0)
    made.add_argument("--json", type=Path, default=ROOT / "mlruns" / "benchmarks" / "surrogate_rivals.json")
    made.add_argument("--from", dest="sources", type=Path, nargs="+", metavar="FILE", help="measure nothing")
    made.add_argument("--plot", type=Path, metavar="FILE", help="picture of the error over n")
    made.add_argument("--detail", action="store_true", help="also the 90th percentile and single fits")
    made.add_argument("--list", action="store_true", help="name problems and methods, and stop")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options, measure what is missing, print and draw."""
    options = parser().parse_args(arguments)
    if options.list:
        named = [f"  {name}: {problem.title}" for name, problem in PROBLEMS.items()]
        print("\n".join(["problems:", *named, "methods:", *(f"  {name}" for name in METHODS)]))
        return
    if options.sources:
        kept = Kept(None)
        for source in options.sources:
            kept.take(source)
    else:
        torch.set_num_threads(1)
        options.methods = with_packages(options.methods, METHODS)
        kept = Kept(options.json)
        measure(kept, options)
    print("\n".join(lines(kept, is_detailed=options.detail)))
    if options.plot:
        from surrogate_rivals.picture import draw

        draw(kept, options.plot)


if __name__ == "__main__":
    main()
