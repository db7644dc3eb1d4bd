"""Ten FMUs whose reset leaves something behind: how many simulations of a store are wrong in the end.

Run `python tests/benchmarks/forgetful_fmus.py [--seeds 10] [--rows 640]`; it needs gcc and takes some ten
minutes. Each FMU simulates a design (`rows`, of one seed) into a store, as `studies simulate` does, and a
search of 40 rounds of two rows, as `studies calibrate` does. All stored simulations that shared a process,
and some that did not, are then compared with those of processes of their own.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
# Behind it: `tests` has a folder `simulation`, too.
sys.path += [str(ROOT / "tests"), str(ROOT / "tests" / "simulation")]

from forgetful_fmu import FAULTS, forgetful_settings, store_of  # noqa: E402

from simulation import PoolModel, uniform_design  # noqa: E402
from simulation.errors import ReuseError  # noqa: E402
from simulation.fmi.fmu import FmuSettings  # noqa: E402
from simulation.pool.worker_process import NewProcess  # noqa: E402
from simulation.store.store import SimulationStore  # noqa: E402
from simulation.store.stored_model import StoredModel  # noqa: E402

N_JUDGED = 60  # rows of their own process that are compared, too


def n_wrong(settings: FmuSettings, store: SimulationStore) -> int:
    """Count stored simulations that are others in a process of their own."""
    theta = np.concatenate([store.theta_reused, store.theta[:N_JUDGED]])
    with PoolModel(settings.open, 2) as pool:
        right = pool.simulate(theta, NewProcess.EACH_ROW)
    return int(np.any(store.read(theta).y != right.y, axis=(1, 2)).sum())


def design(settings: FmuSettings, store: SimulationStore, n: int, seed: int) -> int:
    """Simulate a design, and some of it again if rows were wrong; return how many were repeated."""
    theta = uniform_design(settings.parameter_space, n, seed)
    with PoolModel(settings.open, 2) as pool:
        model = StoredModel(pool, store)
        try:
            model.complete(theta)
        except ReuseError:
            # The rest has processes of their own: enough to see that.
            model.complete(theta[:N_JUDGED])
        return model.reuse.n_repeated


def search(settings: FmuSettings, store: SimulationStore, seed: int) -> int:
    """Simulate rounds of two rows, and repeat the last one as a calibration does."""
    theta = uniform_design(settings.parameter_space, 80, 1000 + seed)
    with PoolModel(settings.open, 2) as pool:
        model = StoredModel(pool, store)
        for start in range(0, len(theta), 2):
            model.simulate(theta[start : start + 2])
        model.repeats(theta[-1])
        return model.reuse.n_repeated


def main() -> None:
    """Print a line for each FMU."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seeds", type=int, default=10)
    options.add_argument("--rows", type=int, default=640)
    options.add_argument("--faults", nargs="+", choices=("NONE", *FAULTS), metavar="FAULT")
    chosen = options.parse_args()
    for fault in chosen.faults or ("NONE", *FAULTS):
        totals = {"design": [0, 0, 0], "search": [0, 0, 0]}
        for seed in range(chosen.seeds):
            with tempfile.TemporaryDirectory() as folder:
                settings = forgetful_settings(Path(folder), fault)
                for name in totals:
                    with store_of(settings, Path(folder) / f"{name}.db") as store:
                        one = totals[name]
                        if name == "design":
                            one[2] += design(settings, store, chosen.rows, seed)
                        else:
                            one[2] += search(settings, store, seed)
                        one[0] += n_wrong(settings, store)
                        one[1] += int(store.is_reuse_given_up)
        line = "; ".join(
            f"{name}: {wrong} wrong, given up {given_up} of {chosen.seeds}, {repeated} repeated"
            for name, (wrong, given_up, repeated) in totals.items()
        )
        print(f"{fault:17s} {line}", flush=True)


if __name__ == "__main__":
    main()
