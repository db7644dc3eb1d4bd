"""Kill commands at random moments and look at what is left: `python tests/benchmarks/command_kills.py`.

Every command is begun in a copy of a project and killed by SIGKILL, itself or one of its processes, twice. It
is then typed again until it succeeds. Its numbers, rows and trials must be those of a project in which
nothing was killed. No process, temporary file or half a file may be left. Exits 1 otherwise.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT)]

STUDY = ("wall", "--profile", "smoke", "--jobs", "2", "-q")
# In this order, each begins where the one before it ended.
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("new", "fmus/wall/Wall.fmu", "--to", "fmus/own", "-q"),
    ("check", *STUDY),
    ("simulate", *STUDY),
    ("sensitivity", *STUDY),
    ("tune", *STUDY),
    ("calibrate", *STUDY, "--method", "paper", "--n-train", "32"),
    ("calibrate", *STUDY, "--max-calls", "12"),
    ("uncertainty", *STUDY),
    ("report", *STUDY),
    ("status", "--json"),
    ("best", "--json"),
    ("reproduce", "wall-smoke/adaptive", "-q"),
    ("run", *STUDY, "--seed", "1"),
)
GRACE_S, LIMIT_S = 60.0, 600.0
VOLATILE = ("wall", "environment", "run_id", "n_reused", "finished", "recipe", "per_second", "_s")


class Watched:
    """A command that runs in a project, with a mark by which all of its processes are known."""

    def __init__(self, project: Path, words: tuple[str, ...], scratch: Path) -> None:
        self.mark = uuid.uuid4().hex
        scratch.mkdir(exist_ok=True)
        own = {"KILLS_MARK": self.mark, "TMPDIR": str(scratch), "PYTHONPATH": str(ROOT)}
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "studies", *words],
            cwd=project,
            env=os.environ | own,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def kill(self, draw: random.Random) -> bool:
        """Kill it, or one of its processes; return whether it was still running."""
        if self.process.poll() is not None:
            return False
        children = psutil.Process(self.process.pid).children(recursive=True)
        if children and draw.random() < 0.3:
            with contextlib.suppress(psutil.Error):
                draw.choice(children).kill()
        else:
            self.process.kill()
        return True

    def ended(self) -> tuple[int, str]:
        """Wait for its end; return exit code and what it said."""
        _, said = self.process.communicate(timeout=LIMIT_S)
        return self.process.returncode, said

    def left(self) -> list[int]:
        """Return its processes that are still there after a while."""
        deadline = time.monotonic() + GRACE_S
        while (found := marked(self.mark)) and time.monotonic() < deadline:
            time.sleep(0.2)
        return found


def marked(mark: str) -> list[int]:
    """Return the processes that carry a mark in their environment."""
    found = []
    for place in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if mark.encode() in place.read_bytes():
                found.append(int(place.parent.name))
    return found


def numbers_of(value: Any) -> Any:
    """Return a record without what differs each time."""
    if isinstance(value, dict):
        return {k: numbers_of(v) for k, v in value.items() if not k.endswith(VOLATILE) and "wall" not in k}
    return [numbers_of(one) for one in value] if isinstance(value, list) else value


def held(project: Path) -> dict[str, Any]:
    """Return the numbers, rows and trials that a project holds."""
    import optuna
    import pyarrow.parquet as pq

    found: dict[str, Any] = {}
    for file in sorted((project / "mlruns" / "results").rglob("*")):
        name = str(file.relative_to(project))
        if file.suffix == ".json":
            content = json.loads(file.read_text())
            found[name] = content.get("digest") if "stage" in content else numbers_of(content)
        elif file.suffix == ".npz":
            with np.load(file) as arrays:
                found[name] = {
                    key: arrays[key].tobytes() for key in arrays.files if not key.endswith(VOLATILE)
                }
    rows: Counter[tuple[float, ...]] = Counter()
    for file in (project / "data").rglob("*.parquet"):
        table = pq.read_table(file)
        names = [name for name in table.column_names if name.startswith("theta")] or table.column_names[:7]
        for row in zip(*(table[name].to_pylist() for name in names), strict=True):
            rows[tuple(str(one) for one in row)] += 1
    found["rows"] = set(rows)
    if (project / "mlruns" / "optuna.db").is_file():
        storage = optuna.storages.RDBStorage(f"sqlite:///{project}/mlruns/optuna.db")
        for study in storage.get_all_studies():
            trials = storage.get_all_trials(study._study_id)
            ended = [one for one in trials if one.state.is_finished() and one.state.name != "FAIL"]
            found[f"trials of {study.study_name}"] = sorted(
                (str(sorted(one.params.items())), one.state.name, str(one.values)) for one in ended
            )
        storage.remove_session()
        storage.engine.dispose()
    return found


def half_files(project: Path, scratch: Path) -> list[str]:
    """Return what should not be there once a command has ended."""
    left = [str(file) for file in scratch.iterdir()] if scratch.is_dir() else []
    return left + [str(one) for name in ("*.tmp", "*.arena", "*-making") for one in project.rglob(name)]


def attacked(
    words: tuple[str, ...], before: Path, after: dict[str, Any], took_s: float, draw: random.Random
) -> str:
    """Kill a command twice, type it again, and say what is wrong; "" where nothing is."""
    with tempfile.TemporaryDirectory(prefix="command-kills-") as name:
        project, scratch = Path(name) / "project", Path(name) / "tmp"
        shutil.copytree(before, project)
        for _ in range(2):
            command = Watched(project, words, scratch)
            time.sleep(draw.uniform(0.05, took_s))
            command.kill(draw)
            command.ended()
            if left := command.left():
                return f"processes are left: {left}"
        for _ in range(3):
            command = Watched(project, words, scratch)
            code, said = command.ended()
            if not code:
                break
        if code:
            return f"exit code {code}: {said[-300:]}"
        if "Traceback" in said:
            return f"a traceback: {said[-300:]}"
        if left := command.left():
            return f"processes are left: {left}"
        if files := half_files(project, scratch):
            return f"files are left: {files[:5]}"
        now = held(project)
        other = [key for key in after if now.get(key) != after[key] and key != "rows"]
        lost = after["rows"] - now["rows"]
        return (f"other numbers: {other[:5]} " if other else "") + (f"{len(lost)} rows lost" if lost else "")


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="the commands of this name alone")
    chosen = parser.parse_args()
    draw, n_wrong, n_kills = random.Random(chosen.seed), 0, 0
    with tempfile.TemporaryDirectory(prefix="command-kills-") as name:
        project, scratch, states = Path(name) / "project", Path(name) / "tmp", []
        for place in ("fmus/wall", "data/wall"):
            shutil.copytree(ROOT / place, project / place, ignore=shutil.ignore_patterns("generated"))
        (project / "studies.toml").write_text("schema = 1\n")
        for number, words in enumerate(COMMANDS):
            before = Path(name) / f"before-{number}"
            shutil.copytree(project, before)
            began = time.monotonic()
            code, said = Watched(project, words, scratch).ended()
            assert code == 0, f"{words}: {said}"
            states.append((words, before, held(project), time.monotonic() - began))
            print(f"{states[-1][3]:.1f} s without a kill: {' '.join(words)}", flush=True)
        states = [state for state in states if chosen.only in (None, state[0][0])]
        told: dict[tuple[str, ...], list[str]] = {state[0]: [] for state in states}
        while n_kills < chosen.kills:
            words, before, after, took_s = states[(n_kills // 2) % len(states)]
            wrong = attacked(words, before, after, took_s, draw)
            n_kills += 2
            told[words].append(wrong)
            if wrong:
                n_wrong += 1
                print(f"WRONG {' '.join(words)}: {wrong}", flush=True)
        for words, found in told.items():
            print(f"{2 * len(found):3d} kills, {sum(map(bool, found))} wrong: {' '.join(words)}")
    print(f"{n_kills} kills: {'good' if not n_wrong else f'{n_wrong} BAD'}")
    return bool(n_wrong)


if __name__ == "__main__":
    sys.exit(main())
