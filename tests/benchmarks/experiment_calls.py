"""What several experiments cost: simulations to the best error, with state equations and without.

Run `python tests/benchmarks/experiment_calls.py [wall office two-rooms] [--experiments 2 4 8] [--truths 4]`.
A recording is cut into experiments of `--days` each; two-rooms takes its own. Every truth is drawn evenly
from the box, simulated by the FMU and disturbed by noise of the sensor's uncertainty. The best error known is
the least of all searches' and of a least-squares search that begins at the truth. Prints a table: simulations
of single experiments to 1.02 times that error, and to the end; gates nothing.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "benchmarks")]

from interval_coverage import in_experiments  # noqa: E402

from simulation import Case, Measurement  # noqa: E402
from simulation.experiments import JoinedModel  # noqa: E402
from simulation.samples import Samples  # noqa: E402
from studies.calibration.polish import LeastSquaresTRF  # noqa: E402
from studies.calibration.problem import CalibrationProblem  # noqa: E402
from studies.calibration.search.adaptive import Adaptive  # noqa: E402
from studies.calibration.state_equations.experiments_ode import WatchedModel, learned_ode, watched_model  # noqa: E402
from studies.calibration.state_equations.states import watching_states  # noqa: E402


@contextmanager
def watched(case: Case) -> Iterator[WatchedModel]:
    """Open the model of a case's experiments."""
    rows = watching_states(case).experiment_rows
    with closing(rows.open()) as parts:
        yield watched_model(case, JoinedModel(parts, rows, case.parameter_space))


def main() -> None:
    """Run all searches and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", default=["wall", "office", "two-rooms"])
    parser.add_argument("--experiments", type=int, nargs="*", default=[1, 2, 4, 8])
    parser.add_argument("--truths", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=200)
    parser.add_argument("--days", type=float, default=0.75)
    options = parser.parse_args()
    paid = "to 1.02 times | to the end"
    head = f"case | experiments | simulations {paid} | without equations: rows {paid} | s"
    print(f"| {head} |\n|---|---:|---:|---:|---:|---:|---:|")
    for name in options.cases:
        for n in options.experiments:
            with tempfile.TemporaryDirectory() as folder:
                case = in_experiments(name, n, options.days, [], Path(folder))
            k = len(case.experiments)
            if k < n and name == "two-rooms":
                print(f"{name}: has {k} experiments to calibrate", file=sys.stderr)
            to_best, to_end = [], []
            began = perf_counter()
            with watched(case) as model:
                for seed in range(options.first_seed, options.first_seed + options.truths):
                    found = runs(case, model, seed)
                    to_best.append([one[0] for one in found])
                    to_end.append([one[1] for one in found])
            cells = [f"{name} | {k}"]
            for column in (0, 1):
                for table in (to_best, to_end):
                    values = np.array(table)[:, column]
                    cells.append(f"{np.median(values):g} ({values.max():g})")
            print(f"| {' | '.join(cells)} | {perf_counter() - began:.0f} |", flush=True)


def runs(case: Case, model: WatchedModel, seed: int) -> list[tuple[float, int]]:
    """Calibrate a synthetic truth with equations and without.

    Returns:
        Of each what it paid to 1.02 times the best error, infinite for never, and to the end: simulations of
        single experiments with equations, rows of all experiments without.
    """
    rng, space = np.random.default_rng(seed), case.parameter_space
    truth = 0.05 + 0.9 * rng.random(space.n_parameters)
    y = model.simulate(space.from_unit(truth[None])).y[0]
    known = case.measurement
    noisy = y + rng.standard_normal(y.shape) * known.uncertainty
    # Where experiments have other lengths, their own samples count.
    outputs = []
    for one, values in zip(known.outputs, noisy.T, strict=True):
        at = one.samples.time
        outputs.append(replace(one, samples=Samples(at, np.interp(at, known.time, values))))
    problem = CalibrationProblem(model, replace(known, outputs=tuple(outputs)), layout=case.layout)
    ode = learned_ode(posed(case, problem.measurement), model, problem)
    k = len(case.experiments)
    found = [
        Adaptive.for_sensor(float(known.uncertainty[0]), max_calls=300).minimize(
            problem, seed=seed, learned_ode=one
        )
        for one in (ode, None)
    ]
    patient = LeastSquaresTRF(ftol=1e-9, xtol=1e-10, max_calls=2000)
    best = min(patient.minimize(problem, truth).mse, *(one.mse for one in found))
    to_best = [one.history.calls_to(1.02 * best) or np.inf for one in found]
    # Rows as simulations: what was simulated alone had counted as whole rows.
    less = ode.n_alone - k * math.ceil(ode.n_alone / k)
    return [
        (k * to_best[0] + less, k * found[0].n_calls + less),
        (to_best[1], found[1].n_calls),
    ]


def posed(case: Case, measurement: Measurement) -> Case:
    """Return a case whose experiments are compared with another measurement, part by part."""
    assert case.layout is not None, "cut into experiments"
    members = []
    for one, its in zip(case.layout.experiments, case.experiments, strict=True):
        begin_s = its.measurement.time[0]
        outputs = []
        for column, own in zip(one.outputs, its.outputs, strict=True):
            samples = measurement.outputs[column].samples
            outputs.append(replace(own, samples=replace(samples, time=samples.time + begin_s)))
        members.append(replace(its, measurement=replace(its.measurement, outputs=tuple(outputs))))
    return replace(case, experiments=tuple(members), measurement=measurement)


if __name__ == "__main__":
    main()
