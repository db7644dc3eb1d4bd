"""How many model calls calibrations need from no initial guess: ours and their peers, everything counted.

    python tests/benchmarks/fewest_calls [--methods adaptive dfols] [--problems office wall] [--seeds 10]
        [--instances 30 31 32] [--json FILE] [--plot FILE]
    python tests/benchmarks/fewest_calls --from FILE [FILE ...] [--plot FILE] [--detail]

Peers end at 1.02 times the best error known; ours run with the command's own settings and end as the command
does: tables show when, at which error, and whether they said "converged". Every run is kept in the JSON file
as soon as it ends and not repeated; a run that a lower best error or a larger budget would have prolonged is.
Fresh numbers after --instances are fresh problems. Prints tables in Markdown: calls and final error at the
end of every problem beside the calls to 1.17 and 1.02 times, and the table of docs/calibration.md and README.
`--from data/benchmarks/fewest_calls.json` prints the kept ones. The peers' packages: pip install -e
'.[benchmark]'.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "benchmarks")]

from benchmark_console import say, with_packages  # noqa: E402

from fewest_calls.counted import run_once  # noqa: E402
from fewest_calls.kept import Kept, KeptProblem  # noqa: E402
from fewest_calls.methods import METHODS  # noqa: E402
from fewest_calls.problems import Problem, brute_force, posed, problems  # noqa: E402
from fewest_calls.table import FACTORS, details, lines  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402

# Below this a batch of processor time is not worth a message. [s]
WORTH_A_LINE = 20.0


def measure(kept: Kept, entry: Problem, options: argparse.Namespace) -> None:
    """Run what is missing of one problem."""
    if options.brute_force is not None:
        entry = replace(entry, n_starts=options.brute_force)
    made = entry.make()
    with posed(made.case) as problem:
        if entry.name not in kept.problems:
            say(f"{entry.name}: brute force")
            found = brute_force(problem, entry, made)
            unit = f"{made.case.outputs[0].unit}²".replace("degC", "K")
            kept.put_problem(KeptProblem(entry.name, entry.family, unit, found.mse, found.how))
            say(f"{entry.name}: {found.mse:.6g} ({found.how})")
        # A run below the best error known moves the target, for runs that are kept already too.
        for _ in range(3):
            if not _run_missing(kept, entry, problem, options):
                break


def _run_missing(
    kept: Kept, entry: Problem, problem: CalibrationProblem, options: argparse.Namespace
) -> bool:
    """Run what is missing; return whether there was anything."""
    was_missing = False
    for name in options.methods:
        method = METHODS[name]
        max_calls = min(options.max_calls or method.max_calls, entry.most_calls)
        for seed in range(options.first_seed, options.first_seed + (options.seeds or method.seeds)):
            best = kept.problems[entry.name].best
            run = kept.get(entry.name, name, seed)
            target = None if method.is_ours else FACTORS[-1] * best
            if run is not None and run.is_complete(target, max_calls):
                continue
            run = run_once(
                method.search,
                problem,
                seed,
                max_calls=max_calls,
                best=best,
                factor=None if method.is_ours else FACTORS[-1],
                at_once=method.at_once,
            )
            kept.put(entry.name, name, seed, run)
            was_missing = True
            if run.ended not in ("target", "budget", "method"):
                say(f"{entry.name}, {name}, seed {seed}: {run.ended}")
            elif run.seconds > WORTH_A_LINE:
                say(f"{entry.name}, {name}, seed {seed}: {run.n_calls} calls, {run.seconds:.0f} s")
    return was_missing


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), metavar="METHOD")
    made.add_argument(
        "--problems", nargs="+", metavar="TEXT", help="those whose name begins so; default: all"
    )
    made.add_argument("--seeds", type=int, help="runs on each problem; default: each method's own")
    made.add_argument("--first-seed", type=int, default=0)
    made.add_argument("--instances", type=int, nargs="*", default=[0, 1, 2, 3, 4], metavar="SEED")
    made.add_argument("--max-calls", type=int, help="budget of each run; default: each method's own")
    made.add_argument(
        "--brute-force", type=int, metavar="N", help="starts for the best error; default: its own"
    )
    made.add_argument("--json", type=Path, default=ROOT / "mlruns" / "benchmarks" / "fewest_calls.json")
    made.add_argument("--from", dest="sources", type=Path, nargs="+", metavar="FILE", help="measure nothing")
    made.add_argument("--plot", type=Path, metavar="FILE", help="picture of the best error over calls")
    made.add_argument("--detail", action="store_true", help="a row for every method on every problem")
    made.add_argument("--list", action="store_true", help="name problems and methods, and stop")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options, measure what is missing, print and draw."""
    options = parser().parse_args(arguments)
    chosen = [
        entry
        for entry in problems(options.instances)
        if options.problems is None or any(entry.name.startswith(text) for text in options.problems)
    ]
    if options.list:
        print(
            "\n".join(
                [
                    "problems:",
                    *(f"  {entry.name}" for entry in chosen),
                    "methods:",
                    *(f"  {m}" for m in METHODS),
                ]
            )
        )
        return
    if options.sources:
        kept = Kept(None)
        for source in options.sources:
            kept.take(source)
    else:
        options.methods = with_packages(options.methods, METHODS)
        kept = Kept(options.json)
        for entry in chosen:
            measure(kept, entry, options)
    print("\n".join(lines(kept)))
    if options.detail:
        print("\n".join(["", *details(kept)]))
    if options.plot:
        from fewest_calls.picture import draw

        draw(kept, options.plot)


if __name__ == "__main__":
    main()
