"""Kill workers and the process that stores their rows at random moments: no row is lost or repeated."""

import itertools
import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from toy_rc import ToyRC

from simulation.pool.supervisor import SCRATCH_PREFIX
from simulation.scratch import sweep
from simulation.store.reuse_check import N_REPEATED
from simulation.store.store import SimulationStore

HERE = Path(__file__).parent
PATIENCE_S = 600.0
N_ROWS, N_WORKERS = 375, 2
# Few enough that no row is lost with its process so often that it fails.
KILLS = ("master", "worker") * 3
# A chunk of 0.05 s, and one row more.
N_CHUNK = 7

# A batch through pool and store, which notes what was begun and what is stored when it starts.
MASTER = """
import sys
from pathlib import Path
sys.path[:0] = {places!r}
import numpy as np
from simulation import PoolModel
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from slow_models import SlowToy

folder = Path({folder!r})
rows, begun, start = np.load(folder / "rows.npy"), folder / "begun", len(list(folder.glob("start-*")))
toy = SlowToy(row_s=0.008, begun=begun)
names = dict(parameter_names=toy.parameter_space.names, output_names=toy.output_names)
with SimulationStore(folder / "toy.db", model_digest="toy", time=toy.time, **names) as store:
    stored = [row.tobytes().hex() for row in rows[store.find(rows)]]
    n_bytes = begun.stat().st_size if begun.exists() else 0
    (folder / f"start-{{start:03d}}").write_text(" ".join([str(n_bytes), *stored]))
    reported = folder / f"reported-{{start:03d}}"
    with PoolModel(toy.open, {n_workers}) as model:
        StoredModel(model, store).complete(rows, on_progress=lambda n: reported.write_text(str(n)))
print("finished")
"""


def _start(script: Path, temporary: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(temporary)},
    )


def _progress(folder: Path) -> list[str]:
    return [file.read_text() for file in sorted(folder.glob("reported-*"))]


def _wait(is_so: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_no_reported_row_is_lost_and_none_is_simulated_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    chance = random.Random(20)
    script, temporary = tmp_path / "master.py", tmp_path / "tmp"
    temporary.mkdir()
    places = [str(HERE), str(HERE.parent), str(HERE.parents[1])]
    script.write_text(MASTER.format(places=places, folder=str(tmp_path), n_workers=N_WORKERS))
    rows = ToyRC().parameter_space.from_unit(np.random.default_rng(1).random((N_ROWS, 2)))
    np.save(tmp_path / "rows.npy", rows)
    master, family = _start(script, temporary), set()

    def children() -> list[psutil.Process]:
        """Workers, and the processes that they are forked from."""
        assert master.poll() is None, "all rows were simulated before the last kill"
        return psutil.Process(master.pid).children(recursive=True)

    try:
        for whom in chance.sample(KILLS, len(KILLS)):
            if whom == "worker":
                _wait(children)
            # Half of the time it gets to work.
            if chance.random() < 0.5:
                before = _progress(tmp_path)
                _wait(lambda before=before: _progress(tmp_path) != before)
            time.sleep(chance.uniform(0.02, 0.15))
            family.update(children())
            if whom == "worker":
                chance.choice(children()).kill()
                continue
            master.kill()
            assert master.communicate() == ("", None)
            master = _start(script, temporary)
        assert master.communicate(timeout=PATIENCE_S) == ("finished\n", None)
    finally:
        master.kill()
        master.wait()
    _check_counts(tmp_path, rows, len(KILLS))
    assert not psutil.wait_procs(family, timeout=PATIENCE_S)[1]
    # The next process removes what the last one that was killed left behind.
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    sweep(SCRATCH_PREFIX)
    assert not [file for file in temporary.iterdir() if not _is_of_a_moment(file)]


def _is_of_a_moment(path: Path) -> bool:
    """Return whether only a process killed within some microseconds of its start leaves this.

    Python's own trial of a temporary folder, which no later process removes; or a folder that is not locked
    yet, which is swept an hour later.
    """
    if path.is_dir():
        return path.name.startswith(".") and {file.name for file in path.iterdir()} <= {".in-use"}
    return re.fullmatch("[a-z0-9_]{8}", path.name) is not None and b"blat".startswith(path.read_bytes())


def _check_counts(folder: Path, rows: np.ndarray, n_kills: int) -> None:
    with SimulationStore.at(folder / "toy.db") as store:
        assert len(store.theta) == len(rows), "every row is stored, and once"
        assert store.read(rows).digest == ToyRC().simulate(rows).digest
    begun = (folder / "begun").read_bytes()
    # What was reported before a start is there at that start, ...
    starts = sorted(folder.glob("start-*"))
    for before, start in itertools.pairwise(starts):
        reported = folder / before.name.replace("start", "reported")
        _, *stored = start.read_text().split()
        if reported.exists():
            assert len(stored) >= int(reported.read_text() or 0)
    # ... and what is there at a start is never begun again, but for some that are repeated, as rows share
    # processes; no more than the rows in hand are.
    for start in starts:
        n_bytes, *stored = start.read_text().split()
        assert len(set(begun[int(n_bytes) :].decode().split()) & set(stored)) <= 3 * N_REPEATED
    n_begun, n_repeated = len(begun.split()), len(starts) * 3 * N_REPEATED
    assert len(rows) <= n_begun <= len(rows) + n_kills * N_WORKERS * N_CHUNK + n_repeated
