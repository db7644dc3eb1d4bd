"""What it takes to write, open and read a large store of simulations.

Run `python tests/benchmarks/store_speed.py [ROWS] [STEPS] [FOLDER] [CHECKOUT]`, by default 200,000 rows of
1,000 steps (about 1.8 GB) in the temporary folder, removed afterwards; it prints one JSON document. Writing,
opening and reading happen in processes of their own, whose peak memory is told. With another checkout of this
repository each of them is measured there, too, right after, and `ratios` are times there over times here.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(os.environ.get("MEASURED_CHECKOUT", Path(__file__).parents[2]))
sys.path.insert(0, str(ROOT))

from simulation import Trajectories  # noqa: E402
from simulation.store.store import SimulationStore  # noqa: E402

N_PARAMETERS, CHUNK, SCATTERED, SMALL, N_SMALL = 14, 8000, 64, 16, 200
NAMES = tuple(f"p{j}" for j in range(N_PARAMETERS))
Measured = dict[str, float]


def open_store(place: Path, n_steps: int) -> SimulationStore:
    return SimulationStore(
        place,
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


def seconds(work: Callable[[], object]) -> float:
    before = time.perf_counter()
    work()
    return time.perf_counter() - before


def write(place: Path, n_rows: int, n_steps: int) -> Measured:
    spent = 0.0
    with open_store(place, n_steps) as store:
        for start in range(0, n_rows, CHUNK):
            block = rows(start, min(CHUNK, n_rows - start), n_steps)
            spent += seconds(lambda block=block: store.append(block))  # type: ignore[misc]
    size = sum(file.stat().st_size for file in place.parent.rglob("*") if file.is_file())
    return {"write_s": spent, "size_to_raw": size / (8 * n_rows * n_steps)}


def write_small(place: Path, n_rows: int, n_steps: int) -> Measured:
    """Write as a command does whose model is asked a few rows at a time."""
    result = {}
    with open_store(place.with_name(f"small-{place.name}"), n_steps) as store:
        for size, name in ((1, "append_1_s"), (SMALL, f"append_{SMALL}_s")):
            blocks = [rows(10**9 * size + i, size, n_steps) for i in range(N_SMALL)]
            result[name] = sum(seconds(lambda one=one: store.append(one)) for one in blocks) / N_SMALL  # type: ignore[misc]
    return result


def opened(place: Path, n_rows: int, n_steps: int) -> Measured:
    before = time.perf_counter()
    with open_store(place, n_steps) as store:
        result = {"open_s": time.perf_counter() - before}
        wanted = rows(0, min(CHUNK, n_rows), n_steps).theta
        result["find_8000_s"] = seconds(lambda: store.find(wanted))
        assert store.find(wanted).all()
        assert len(store.theta) == n_rows
    return result


def read(place: Path, n_rows: int, n_steps: int) -> Measured:
    with open_store(place, n_steps) as store:
        theta = store.theta
        scattered = theta[np.random.default_rng(1).integers(n_rows, size=SCATTERED)]
        together = theta[n_rows // 2 : n_rows // 2 + SCATTERED]
        return {
            "read_64_scattered_s": seconds(lambda: store.read(scattered)),
            "read_64_together_s": seconds(lambda: store.read(together)),
            "stream_s": seconds(lambda: [block.n for block in store.stream(theta)]),
        }


WORK: dict[str, Callable[[Path, int, int], Measured]] = {
    "write": write,
    "write_small": write_small,
    "open": opened,
    "read": read,
}


def measured(checkout: Path, *arguments: str) -> Measured:
    """Do one kind of work with the code of a checkout, in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--work", *arguments],
        env=os.environ | {"MEASURED_CHECKOUT": str(checkout)},
        capture_output=True,
        text=True,
        check=True,
    )
    found: Measured = json.loads(done.stdout)
    return found


def main() -> None:
    """Measure and print."""
    n_rows, n_steps = (int(text) for text in (sys.argv[1:3] + ["200000", "1000"][len(sys.argv) - 1 :]))
    place = Path(sys.argv[3]) if len(sys.argv) > 3 else Path(tempfile.gettempdir())
    checkouts = {"here": ROOT} | ({"there": Path(sys.argv[4])} if len(sys.argv) > 4 else {})
    needed, free = 1.3 * 8 * n_rows * n_steps * len(checkouts), shutil.disk_usage(place).free
    if free < needed:
        sys.exit(f"{place} has {free / 1e9:.1f} GB free, this needs {needed / 1e9:.1f}; ask for fewer rows")
    found: dict[str, Measured] = {name: {} for name in checkouts}
    with tempfile.TemporaryDirectory(dir=place) as folder:
        for what in WORK:
            for name, checkout in checkouts.items():
                (Path(folder) / name).mkdir(exist_ok=True)
                done = measured(checkout, what, str(n_rows), str(n_steps), f"{folder}/{name}/store.db")
                done[f"{what}_peak_MB"] = done.pop("peak_MB")
                found[name] |= done
    result: dict[str, object] = {"rows": n_rows, "steps": n_steps, **found}
    if "there" in found:
        result["ratios"] = {key: round(found["there"][key] / found["here"][key], 2) for key in found["here"]}
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        what, n_rows, n_steps, folder = sys.argv[2:]
        found = WORK[what](Path(folder), int(n_rows), int(n_steps))
        found["peak_MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps(found))
    else:
        main()
