"""Rows per second of co-simulation, in this process and in others, and what checking shared processes costs.

Run `python tests/benchmarks/cosimulation_speed.py [CASE] [--rows N]`, which prints one JSON document. Its
figures are the best of some rounds in turns: other work on the machine only ever makes them lower.
`repeated` counts the simulations that are made once more to see whether rows of a shared process depend on
each other.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation import PoolModel, load_case, uniform_design  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402
from simulation.case import Case  # noqa: E402
from simulation.pool.worker_process import NewProcess  # noqa: E402
from simulation.store.store import SimulationStore  # noqa: E402
from simulation.store.stored_model import StoredModel  # noqa: E402

ROUNDS = 3
N_FEW = 40  # of what takes a process each


def in_this_process(case: Case, theta: FloatArray) -> float:
    """Return rows per second of the model itself."""
    with case.open_model() as model:
        model.simulate(theta[:2])
        began = time.perf_counter()
        model.simulate(theta)
        return len(theta) / (time.perf_counter() - began)


def in_others(case: Case, theta: FloatArray, n_jobs: int, new_process: NewProcess) -> float:
    """Return rows per second of a pool."""
    with PoolModel(case.make_model, n_jobs) as pool:
        pool.simulate(theta[:4], new_process)
        began = time.perf_counter()
        pool.simulate(theta, new_process)
        return len(theta) / (time.perf_counter() - began)


def stored(case: Case, theta: FloatArray, *, is_checked: bool) -> tuple[float, int]:
    """Return rows per second of a pool around a store, and how many rows were repeated."""
    with (
        tempfile.TemporaryDirectory() as folder,
        PoolModel(case.make_model, 1) as pool,
        SimulationStore(
            Path(folder) / "rows.db",
            model_digest="benchmark",
            parameter_names=case.parameter_space.names,
            output_names=case.settings.output_names,
            time=case.scenario.time,
        ) as store,
    ):
        model = StoredModel(pool, store)
        # Without the checks, as if the FMU had been found random.
        model.reuse.is_random = not is_checked
        pool.simulate(theta[:4])
        began = time.perf_counter()
        model.complete(theta)
        return len(theta) / (time.perf_counter() - began), model.reuse.n_repeated


def main() -> None:
    """Print the figures."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("case", nargs="?", type=Path, default=ROOT / "fmus" / "office" / "case.toml")
    options.add_argument("--rows", type=int, default=10_000)
    chosen = options.parse_args()
    case = load_case(chosen.case)
    theta = uniform_design(case.parameter_space, chosen.rows, 0)
    found: dict[str, float] = {}
    n_repeated = 0
    for _ in range(ROUNDS):
        speeds = {
            "in_process": in_this_process(case, theta),
            "one_job": in_others(case, theta, 1, NewProcess.WHEN_NEEDED),
            "two_jobs": in_others(case, theta, 2, NewProcess.WHEN_NEEDED),
            "process_each": in_others(case, theta[:N_FEW], 1, NewProcess.EACH_ROW),
            "stored_unchecked": stored(case, theta, is_checked=False)[0],
        }
        speeds["stored"], n_repeated = stored(case, theta, is_checked=True)
        found = {name: max(speed, found.get(name, 0.0)) for name, speed in speeds.items()}
    rounded = {name: round(speed, 1) for name, speed in found.items()}
    print(json.dumps({"case": case.name, "rows": chosen.rows, "rows_per_s": rounded, "repeated": n_repeated}))


if __name__ == "__main__":
    main()
