"""One worker, two workers and this process on the office: what supervising costs and what a second core adds.

Run `python tests/benchmarks/workers_speed.py [rows] [rounds]`; it prints JSON. Needs the office's FMU.
The three take turns, and the best of the rounds counts: other work on the machine only ever adds to a time.
`ceiling` is what the machine gives two processes that have nothing to do with each other.
"""

import json
import multiprocessing
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation import PoolModel, load_case  # noqa: E402

FOLDER = ROOT / "fmus" / "office"


def timed(work: Callable[[], object]) -> float:
    """Return how long it takes. [s]."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def alone(rows: np.ndarray, go, done, stop) -> None:
    """Simulate all rows in this process whenever told to."""
    with load_case(FOLDER).open_model() as model:
        model.simulate(rows[:50])
        while True:
            go.wait()
            if stop.is_set():
                return
            model.simulate(rows)
            done.wait()


def ceilings(rows: np.ndarray, rounds: int) -> list[float]:
    """Return how much more two unrelated processes do in a time than one does."""
    context = multiprocessing.get_context("spawn")
    sets = []
    for n in (1, 2):
        go, done, stop = context.Barrier(n + 1), context.Barrier(n + 1), context.Event()
        processes = [context.Process(target=alone, args=(rows, go, done, stop)) for _ in range(n)]
        for process in processes:
            process.start()
        sets.append((go, done, stop, processes))

    def run(go, done, *_) -> None:
        go.wait()
        done.wait()

    times = [[timed(lambda one=one: run(*one)) for one in sets] for _ in range(rounds + 1)][1:]
    for go, _, stop, processes in sets:
        stop.set()
        go.wait()
        for process in processes:
            process.join()
    return [2 * min(one for one, _ in times) / min(two for _, two in times)]


def cpu_s() -> float:
    """Return the processor time of this process and of all workers so far. [s]."""
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(sum(process.cpu_times()[:2]) for process in family)


def main() -> None:
    """Measure."""
    n_rows = int(sys.argv[1]) if len(sys.argv) > 1 else 6000
    rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 8
    case = load_case(FOLDER)
    rows = case.parameter_space.from_unit(
        np.random.default_rng(0).random((n_rows, case.parameter_space.n_parameters))
    )
    result: dict[str, object] = {"rows": n_rows, "rounds": rounds, "load_before": os.getloadavg()[0]}
    with (
        case.open_model() as here,
        PoolModel(case.make_model, 1) as one,
        PoolModel(case.make_model, 2) as two,
    ):
        result["first_row_s"] = timed(lambda: one.simulate(rows[:1]))
        models = {"here": here, "one": one, "two": two}
        expected = here.simulate(rows).digest
        assert one.simulate(rows).digest == two.simulate(rows).digest == expected
        times: dict[str, list[float]] = {name: [] for name in models}
        cpu: dict[str, list[float]] = {name: [] for name in models}
        for _ in range(rounds):
            for name, model in models.items():
                before = cpu_s()
                times[name].append(timed(lambda model=model: model.simulate(rows)))
                cpu[name].append(cpu_s() - before)
        for name, spent in times.items():
            result[f"{name}_us_per_row"] = round(min(spent) / n_rows * 1e6, 1)
            result[f"{name}_cpu_us_per_row"] = round(min(cpu[name]) / n_rows * 1e6, 1)
        result["two_over_one"] = round(min(times["one"]) / min(times["two"]), 3)
        result["two_over_here"] = round(min(times["here"]) / min(times["two"]), 3)
        result["two_over_one_median_of_rounds"] = round(
            statistics.median(a / b for a, b in zip(times["one"], times["two"], strict=True)), 3
        )
        result["processes"] = two.n_processes
        single = [timed(lambda: one.simulate(rows[:1])) for _ in range(200)]
        result["single_call_us"] = round(statistics.median(single) * 1e6)
        single = [timed(lambda: here.simulate(rows[:1])) for _ in range(200)]
        result["single_call_here_us"] = round(statistics.median(single) * 1e6)
    result["ceiling"] = [round(value, 3) for value in ceilings(rows, rounds)]
    with PoolModel(case.make_model, 1) as model:

        def in_a_new_process() -> float:
            model.close()
            return timed(lambda: model.simulate(rows[:1]))

        result["fresh_process_and_row_s"] = round(min(in_a_new_process() for _ in range(5)), 3)
    result["load_after"] = os.getloadavg()[0]
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
