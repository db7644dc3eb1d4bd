"""What stored simulations save a calibration: those of an earlier one, or of a training set.

Run `python tests/benchmarks/warm_start_saving.py [--problems NAME ...] [--seeds 5] [--sizes 64 256]
[--change 0.1]`. The earlier calibration was made to other data: the same measurement and a slow wave of
`--change` times its standard deviation, whose period and phase are drawn. Every calibration is that of
`studies calibrate`, with state equations where it can learn them (an earlier calibration's rows are stored
with their states, a training set's are not), and ends by itself, or after 200 calls.
Errors are compared with the best that `data/benchmarks/fewest_calls.json` knows. Prints a table of medians
(and the worst) and gates nothing.
"""

import argparse
import statistics
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(Path(__file__).parent)]

from fewest_calls.kept import Kept  # noqa: E402
from fewest_calls.problems import PosedModel, posed, problems  # noqa: E402
from interval_coverage import Diary  # noqa: E402

from simulation.arrays import FloatArray  # noqa: E402
from studies.calibration.problem import CalibrationProblem, Evaluation  # noqa: E402
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult  # noqa: E402
from studies.calibration.search.row_choice import best_and_far  # noqa: E402
from studies.calibration.state_equations.learned_ode import LearnedODE  # noqa: E402
from studies.calibration.state_equations.learner import EquationLearner  # noqa: E402
from studies.calibration.state_equations.states import StateRows, WatchedModel  # noqa: E402

PROBLEMS = ("office, days 0-10", "office-recorded, days 0-10", "wall", "vanderpol", "two basins")
NEVER = float("inf")


def with_wave(problem: CalibrationProblem, size: float, seed: int) -> CalibrationProblem:
    """Return the problem with a slow wave upon its measurement."""
    rng, measurement = np.random.default_rng([seed, 1]), problem.measurement
    phase, n_waves = rng.random(), rng.uniform(0.5, 2.0)
    outputs = []
    for one in measurement.outputs:
        time, values = one.samples.time, one.samples.values
        wave = np.sin(2.0 * np.pi * (phase + n_waves * time / measurement.time[-1]))
        samples = replace(one.samples, values=values + size * values.std() * wave)
        outputs.append(replace(one, samples=samples))
    return replace(problem, measurement=replace(measurement, outputs=tuple(outputs)))


def settings_for(problem: CalibrationProblem) -> Adaptive:
    """Return those of `studies calibrate --max-calls 200`."""
    return Adaptive.for_sensor(float(problem.measurement.uncertainty[0]), max_calls=200)


def calibrated(
    problem: CalibrationProblem,
    seed: int,
    watched: WatchedModel,
    known: Evaluation | None = None,
    *,
    are_seen: bool = True,
) -> AdaptiveResult:
    """Calibrate as `studies calibrate` does.

    Args:
        problem: The problem, posed to the watched model or one around it.
        seed: Of the calibration.
        watched: Knows what states did in the last rows it was asked.
        known: Rows that are known beforehand, asked of it last.
        are_seen: Whether what their states did is known, too.
    """

    def seen(theta: FloatArray) -> StateRows:
        rows = watched.seen(theta)
        is_hidden = not are_seen and known is not None and theta is known.theta
        return StateRows(*(np.full_like(part, np.nan) for part in rows)) if is_hidden else rows

    equations = LearnedODE([EquationLearner(watched.signals, seen, problem)], problem)
    return settings_for(problem).minimize(problem, seed=seed, known=known, learned_ode=equations)


def nothing(problem: CalibrationProblem, seed: int) -> FloatArray:
    """Know no rows."""
    return np.empty((0, problem.space.n_parameters))


def earlier(change: float) -> Callable[[CalibrationProblem, int], FloatArray]:
    """Know the rows of a calibration to other data."""

    def rows(problem: CalibrationProblem, seed: int) -> FloatArray:
        other = with_wave(problem, change, seed)
        diary = Diary(problem.model)
        assert isinstance(problem.model, PosedModel)
        calibrated(other.on(diary), seed + 1000, problem.model.states)
        return problem.space.to_unit(np.concatenate([answer.theta for answer in diary.answers]))

    return rows


def training_set(n: int) -> Callable[[CalibrationProblem, int], FloatArray]:
    """Know rows drawn evenly from the box."""

    def rows(problem: CalibrationProblem, seed: int) -> FloatArray:
        return np.random.default_rng([seed, 2]).random((n, problem.space.n_parameters))

    return rows


def shown(values: list[float]) -> str:
    """Say median and worst."""
    median, worst = statistics.median(values), max(values)
    n_never = sum(value == NEVER for value in values)
    end = f"never {n_never} of {len(values)}" if n_never else f"{worst:g}"
    return f"never {n_never} of {len(values)}" if median == NEVER else f"{median:g} ({end})"


def main() -> None:
    """Run what is asked for and print a line per problem and beginning."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--sizes", type=int, nargs="*", default=[64, 256])
    parser.add_argument("--change", type=float, default=0.1)
    options = parser.parse_args()
    kept = Kept(ROOT / "data" / "benchmarks" / "fewest_calls.json")
    beginnings = {"nothing": nothing, "an earlier calibration": earlier(options.change)}
    beginnings |= {f"{n} training rows": training_set(n) for n in options.sizes}
    print(
        "| problem | begins with | calls to 1.17 times | to 1.02 times | in all |\n|---|---|---:|---:|---:|"
    )
    for entry in problems([]):
        if entry.name not in options.problems:
            continue
        best = kept.problems[entry.name].best
        with posed(entry.make().case) as problem:
            for name, rows_of in beginnings.items():
                results = []
                for seed in range(options.seeds):
                    known = problem.evaluate(rows_of(problem, seed))
                    known = problem.evaluate(known.u[best_and_far(known.u, -known.objective)])
                    assert isinstance(problem.model, PosedModel)
                    are_seen = "training" not in name
                    found = calibrated(problem, seed, problem.model.states, known, are_seen=are_seen)
                    results.append(found)
                reached = [
                    [
                        NEVER if (n := found.history.calls_to(factor * best)) is None else n
                        for found in results
                    ]
                    for factor in (1.17, 1.02)
                ]
                cells = [shown(values) for values in (*reached, [found.n_calls for found in results])]
                print(f"| {entry.name} | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
