"""Simulate the office 200,000 times and watch memory and descriptors: `python tests/benchmarks/long_run.py`.

All processes of a parallel model are added up after every batch. Prints a line for every tenth of the rows;
exits 1 where memory grew by more than 5 % after the first tenth with as many processes as at the end, or a
descriptor more is open then.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from made_up_recording import write_csv_files  # noqa: E402

from simulation import PoolModel, load_case, uniform_design  # noqa: E402

GROWTH = 0.05
N_PARTS = 10


def in_use() -> tuple[float, int, int]:
    """Return memory [MB], descriptors and processes of this process and those below it."""
    me = psutil.Process()
    family = [me, *me.children(recursive=True)]
    return (
        sum(one.memory_full_info().pss for one in family) / 1e6,
        sum(one.num_fds() for one in family),
        len(family),
    )


def ran(n_rows: int, n_workers: int, batch: int) -> bool:
    """Simulate, and say whether memory and descriptors stayed as they were."""
    with tempfile.TemporaryDirectory(prefix="long-run-") as name:
        folder = Path(name)
        (folder / "fmus" / "office").mkdir(parents=True)
        for file in ("Office.fmu", "case.toml"):
            content = (ROOT / "fmus" / "office" / file).read_bytes()
            (folder / "fmus" / "office" / file).write_bytes(content)
        write_csv_files(folder / "data" / "office")
        case = load_case(folder / "fmus" / "office" / "case.toml")
        theta = uniform_design(case.parameter_space, batch, seed=1)
        seen: list[tuple[float, int, int]] = []
        with PoolModel(case.make_model, n_workers) as model:
            first, began, done = model.simulate(theta), time.monotonic(), 0
            while done < n_rows:
                answer = model.simulate(theta)
                assert np.array_equal(answer.y, first.y, equal_nan=True), "another answer to the same row"
                done += batch
                if done * N_PARTS // n_rows > len(seen):
                    seen.append(in_use())
                    memory, descriptors, processes = seen[-1]
                    print(
                        f"{done:,} rows, {time.monotonic() - began:.0f} s: {memory:.1f} MB, "
                        f"{descriptors} descriptors, {processes} processes",
                        flush=True,
                    )
        # A batch that was held up makes another process worth its start: compared are as many processes.
        alike = next(one for one in seen if one[2] == seen[-1][2])
        growth = seen[-1][0] / alike[0] - 1.0
        more = seen[-1][1] - alike[1]
        is_good = growth <= GROWTH and more <= 0
        print(f"memory {growth:+.1%}, descriptors {more:+d}: {'good' if is_good else 'BAD'}")
        return is_good


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=200_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--batch", type=int, default=1000)
    chosen = parser.parse_args()
    return not ran(chosen.rows, chosen.workers, chosen.batch)


if __name__ == "__main__":
    sys.exit(main())
