"""Kill workers and the process that stores their rows at random moments: no row is lost or repeated."""

import itertools
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from toy_rc import ToyRC

from simulation.pool.supervisor import SCRATCH_PREFIX
from simulation.scratch import sweep
from simulation.store.store import SimulationStore

HERE = Path(__file__).parent
N_ROWS, N_MOMENTS, N_WORKERS = 400, 20, 2
# A row fails whose process is lost again and again: so many deaths in a row at most.
N_DEATHS = 2
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


def _wait_for_progress(folder: Path, before: list[str], master: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 60.0
    while master.poll() is None and _progress(folder) == before and time.monotonic() < deadline:
        time.sleep(0.01)


def test_no_reported_row_is_lost_and_none_is_simulated_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    chance = random.Random(20)
    script, temporary = tmp_path / "master.py", tmp_path / "tmp"
    temporary.mkdir()
    places = [str(HERE), str(HERE.parent), str(HERE.parents[1])]
    script.write_text(MASTER.format(places=places, folder=str(tmp_path), n_workers=N_WORKERS))
    rows = ToyRC().parameter_space.from_unit(np.random.default_rng(1).random((N_ROWS, 2)))
    np.save(tmp_path / "rows.npy", rows)
    master, n_kills, family = _start(script, temporary), {"master": 0, "worker": 0}, set()
    progress: list[str] = []
    n_deaths = 0
    try:
        for _ in range(N_MOMENTS):
            time.sleep(chance.uniform(0.02, 0.15))
            if n_deaths == N_DEATHS:
                _wait_for_progress(tmp_path, progress, master)
            progress, before = _progress(tmp_path), progress
            n_deaths = n_deaths if progress == before else 0
            children = psutil.Process(master.pid).children(recursive=True) if master.poll() is None else []
            family.update(children)
            # Half of the kills hit a worker, or the processes that they are forked from.
            whom = "worker" if children and chance.random() < 0.5 else "master"
            victim = chance.choice(children).pid if whom == "worker" else master.pid
            try:
                os.kill(victim, signal.SIGKILL)
            except ProcessLookupError:
                continue
            n_kills[whom] += 1
            n_deaths += 1
            if whom == "master":
                n_deaths = 0
                said, _ = master.communicate()
                assert said in ("", "finished\n")
                master = _start(script, temporary)
                # Half of the time it gets to work.
                if chance.random() < 0.5:
                    _wait_for_progress(tmp_path, progress, master)
        said, _ = master.communicate(timeout=60)
        assert said == "finished\n"
    finally:
        master.kill()
        master.wait()
    assert n_kills["master"] >= 4
    assert n_kills["worker"] >= 4
    _check_counts(tmp_path, rows, sum(n_kills.values()))
    assert not psutil.wait_procs(family, timeout=5)[1]
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
    # ... and what is there at a start is never begun again; no more than the rows in hand are.
    for start in starts:
        n_bytes, *stored = start.read_text().split()
        assert not set(begun[int(n_bytes) :].decode().split()) & set(stored)
    n_begun = len(begun.split())
    assert len(rows) <= n_begun <= len(rows) + n_kills * N_WORKERS * N_CHUNK
