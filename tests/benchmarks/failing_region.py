"""What a region costs that cannot be simulated: `python tests/benchmarks/failing_region.py --seeds 16`.

Rooms with six parameters, drawn by seed, of whose box half to nine tenths fail; the optimum lies beside.
Prints calls, failed calls and final error of every adaptive calibration without state equations.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "calibration")]

from failing_room_for_tests import SENSOR, failing_room  # noqa: E402

from simulation import ForwardModel, Trajectories  # noqa: E402
from simulation.arrays import FloatArray  # noqa: E402
from simulation.forward_model import WrappedModel  # noqa: E402
from studies.calibration.search.adaptive import Adaptive  # noqa: E402

RIGHT = 1.02


class _Counting(WrappedModel):
    """A model that notes which of its rows failed."""

    def __init__(self, model: ForwardModel, failed: list[bool]) -> None:
        super().__init__(model)
        self._failed = failed

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = self._model.simulate(theta)
        self._failed += answer.failed.tolist()
        return answer


def main() -> None:
    """Calibrate and print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument(
        "--first-seed", type=int, default=100, help="0 to 9 were used while the rule was made"
    )
    options.add_argument("--seeds", type=int, default=16)
    options.add_argument("--max-calls", type=int, default=150)
    chosen = options.parse_args()
    print("seed  share that fails  calls  failed  to 1.02  final/best  converged")
    all_calls, all_failed, reached, n_right = [], [], [], 0
    for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
        one = failing_room(seed)
        failed: list[bool] = []
        settings = Adaptive.for_sensor(SENSOR, max_calls=chosen.max_calls)
        found = settings.minimize(one.problem.on(_Counting(one.problem.model, failed)), seed=seed)
        calls = found.history.calls_to(RIGHT * one.best)
        ratio = found.mse / one.best
        print(
            f"{seed:4d}  {one.share:16.2f}  {found.n_calls:5d}  {sum(failed):6d}  {calls or 'never':>7}  "
            f"{ratio:10.3f}  {found.converged}",
            flush=True,
        )
        all_calls.append(found.n_calls)
        all_failed.append(sum(failed))
        reached.append(np.inf if calls is None else calls)
        n_right += ratio <= RIGHT
    print(
        f"{n_right} of {chosen.seeds} within {RIGHT} times the best error, median of calls to it "
        f"{np.median(reached):g}, to the end {np.median(all_calls):g}; "
        f"{sum(all_failed) / sum(all_calls):.0%} of the calls failed"
    )


if __name__ == "__main__":
    main()
