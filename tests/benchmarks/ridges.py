"""How often parameters that act through products are named, with noise and without.

Run `python tests/benchmarks/ridges.py [--seeds 10]`. 2R1C (R1, R2 and C act through R1 C and R2 C) and RC
beside a start value are calibrated with and without state equations, to data without noise and with noise
below and at the sensor's uncertainty of 0.1 K, then judged as `studies uncertainty` does. Prints in how many
runs the calibration names exactly the ridge, in how many the sample shows all its pairs, and in how many both
call the same parameters determined. Gates nothing.
"""

import argparse
import sys
from itertools import combinations
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "calibration")]

from moving_for_tests import measured, with_equations  # noqa: E402
from test_determined import RIDGES, judged_by_uncertainty  # noqa: E402

from studies.calibration.search.adaptive import Adaptive  # noqa: E402
from studies.calibration.uncertainty.findings import compensations, knowledge  # noqa: E402
from studies.stages.calibrated_point import determined  # noqa: E402

SENSOR = 0.1
NOISES = 0.0, 0.03, 0.1


def judged(name: str, noise: float, seed: int, *, has_equations: bool) -> tuple[bool, bool, bool]:
    """Calibrate and judge; return whether ridge and pairs are named, and both agree."""
    model, truth, ridge, _ = RIDGES[name]
    problem = measured(model, np.array(truth), noise, sensor=SENSOR, seed=seed)
    if has_equations:
        found, _ = with_equations(problem, seed=seed, max_calls=60)
    else:
        found = Adaptive(max_calls=60).minimize(problem, seed=seed)
    said = determined(problem.space.names, problem.measurement, None, y=found.y, slopes=found.slopes)
    if said is None:
        return False, False, False
    assessed = judged_by_uncertainty(problem, found)
    sample = assessed.sample.particles
    pairs = {(one.first, one.second) for one in compensations(problem.space, sample)}
    known = knowledge(problem.space, sample, assessed.local.determined)
    open_there = tuple(one for one, what in known.items() if what != "determined")
    return said.ridges == (ridge,), pairs == set(combinations(ridge.names, 2)), open_there == said.open


def main() -> None:
    """Print a line for each model, noise and way to search."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--seeds", type=int, default=10)
    n = options.parse_args().seeds
    for name in RIDGES:
        for noise in NOISES:
            for has_equations in (True, False):
                runs = [judged(name, noise, seed, has_equations=has_equations) for seed in range(n)]
                ridge, pairs, agree = (sum(column) for column in zip(*runs, strict=True))
                how = "with equations" if has_equations else "without equations"
                said = f"ridge named {ridge}, pairs {pairs}, agreed {agree} of {n}"
                print(f"{name}, noise {noise:g} K, {how}: {said}", flush=True)


if __name__ == "__main__":
    main()
