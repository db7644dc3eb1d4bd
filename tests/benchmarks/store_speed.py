"""What it takes to write, open and read a large store of simulations.

Run `python tests/benchmarks/store_speed.py [ROWS] [STEPS] [FOLDER]`, by default 200,000 rows of 1,000 steps
(about 1.5 GB) in the temporary folder, removed afterwards; it prints one JSON document. Writing, opening and
reading happen in processes of their own, whose peak memory is told.
"""

import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation.store.store import SimulationStore  # noqa: E402
from simulation.trajectories import Trajectories  # noqa: E402

N_PARAMETERS, CHUNK, SCATTERED = 14, 8000, 64
NAMES = tuple(f"p{j}" for j in range(N_PARAMETERS))


def open_store(folder: Path, n_steps: int) -> SimulationStore:
    return SimulationStore(
        folder,
        model_digest="b" * 64,
        parameter_names=NAMES,
        output_names=("T",),
        time=np.arange(n_steps) * 1.0,
    )


def rows(start: int, n: int, n_steps: int) -> Trajectories:
    """Temperatures of a room, as an irregular signal filtered by two time constants would have them."""
    rng = np.random.default_rng(start)
    theta = rng.random((n, N_PARAMETERS))
    day = np.sin(2 * np.pi * np.arange(n_steps) / 48)
    drift = np.cumsum(rng.normal(0.0, 0.05, n_steps))
    y = 293 + theta[:, :1] * day + theta[:, 1:2] * drift + np.exp(-theta[:, 2:3] * np.arange(n_steps) / 50)
    return Trajectories(theta, y[:, :, None], np.arange(n_steps) * 1.0, NAMES, ("T",), ("",) * n)


def write(folder: Path, n_rows: int, n_steps: int) -> dict[str, float]:
    spent = 0.0
    with open_store(folder, n_steps) as store:
        for start in range(0, n_rows, CHUNK):
            block = rows(start, min(CHUNK, n_rows - start), n_steps)
            before = time.perf_counter()
            store.append(block)
            spent += time.perf_counter() - before
    size = sum(file.stat().st_size for file in folder.rglob("*.parquet"))
    raw = 8 * n_rows * n_steps
    return {
        "write_MB_per_s": raw / spent / 1e6,
        "write_s": spent,
        "size_GB": size / 1e9,
        "size_to_raw": size / raw,
        "parts": len(list(folder.glob("*.parquet"))),
    }


def opened(folder: Path, n_rows: int, n_steps: int) -> dict[str, float]:
    before = time.perf_counter()
    with open_store(folder, n_steps) as store:
        result = {"open_s": time.perf_counter() - before}
        wanted = rows(0, CHUNK, n_steps).theta
        before = time.perf_counter()
        assert store.find(wanted).all()
        result["find_8000_s"] = time.perf_counter() - before
        assert len(store.theta) == n_rows
    return result


def read(folder: Path, n_rows: int, n_steps: int) -> dict[str, float]:
    with open_store(folder, n_steps) as store:
        theta = store.theta
        scattered = theta[np.random.default_rng(1).integers(n_rows, size=SCATTERED)]
        before = time.perf_counter()
        store.read(scattered)
        result = {"read_64_scattered_s": time.perf_counter() - before}
        before = time.perf_counter()
        store.read(theta[n_rows // 2 : n_rows // 2 + SCATTERED])
        result["read_64_together_s"] = time.perf_counter() - before
        before, total = time.perf_counter(), 0
        for block in store.stream():
            total += block.n
        assert total == n_rows
        spent = time.perf_counter() - before
    return result | {"stream_s": spent, "stream_MB_per_s": 8 * n_rows * n_steps / spent / 1e6}


WORK: dict[str, Callable[[Path, int, int], dict[str, float]]] = {
    "write": write,
    "open": opened,
    "read": read,
}


def main() -> None:
    """Measure and print."""
    n_rows, n_steps = (int(text) for text in (sys.argv[1:3] + ["200000", "1000"][len(sys.argv) - 1 :]))
    place = Path(sys.argv[3]) if len(sys.argv) > 3 else Path(tempfile.gettempdir())
    needed, free = 8 * n_rows * n_steps, shutil.disk_usage(place).free
    if free < 1.2 * needed:
        sys.exit(
            f"{place} has {free / 1e9:.1f} GB free, this needs {1.2 * needed / 1e9:.1f}; ask for fewer rows"
        )
    result: dict[str, object] = {"rows": n_rows, "steps": n_steps, "raw_GB": needed / 1e9}
    with tempfile.TemporaryDirectory(dir=place) as folder:
        for what in WORK:
            arguments = [what, str(n_rows), str(n_steps), f"{folder}/store"]
            done = subprocess.run(
                [sys.executable, __file__, "--work", *arguments], capture_output=True, text=True, check=True
            )
            result[what] = json.loads(done.stdout)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        what, n_rows, n_steps, folder = sys.argv[2:]
        found = WORK[what](Path(folder), int(n_rows), int(n_steps))
        found["peak_MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps(found))
    else:
        main()
