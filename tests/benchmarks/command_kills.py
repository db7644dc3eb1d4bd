"""Kill commands at random moments and look at what is left: `python tests/benchmarks/command_kills.py`.

Every command is begun in a copy of a project and killed by SIGKILL, itself or one of its processes, twice. It
is then typed again until it succeeds. Its numbers, rows, trials and files must be those of a project in which
nothing was killed. No process, open run of MLflow, temporary file or half a file may be left. Exits 1
otherwise. With `--postgresql`, trials and runs are in databases on a server, else in files.
"""

import argparse
import contextlib
import itertools
import json
import os
import random
import shutil
import sqlite3
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import sqlalchemy

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from held_for_tests import (  # noqa: E402
    begun_in,
    half_files,
    held,
    numbers_of,
    open_runs,
    wrong_of,
)
from postgres_for_tests import PostgresServer  # noqa: E402

from studies.paths import ProjectPaths  # noqa: E402

STUDY = ("wall", "--profile", "smoke", "--jobs", "2", "-q")
# In this order, each begins where the one before it ended.
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("new", "fmus/wall/Wall.fmu", "--to", "fmus/own", "-q"),
    ("check", *STUDY),
    ("simulate", *STUDY),
    ("sensitivity", *STUDY, "--fmu"),
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
GRACE_S, LIMIT_S = 60.0, 1800.0


@dataclass(frozen=True)
class Project:
    """A project, and its database where that is on a server.

    Attributes:
        folder: Where it lies.
        server: PostgreSQL; None: it has files.
        url: Of its database there.
    """

    folder: Path
    server: PostgresServer | None = None
    url: str | None = None

    def copied(self, folder: Path) -> "Project":
        """Copy it, with its database."""
        shutil.copytree(self.folder, folder)
        return Project(folder, self.server, self.server.new_database(self.url) if self.server else None)

    @contextlib.contextmanager
    def lent(self) -> Iterator["Project"]:
        """Yield a copy that is removed afterwards."""
        with tempfile.TemporaryDirectory(prefix="command-kills-") as name:
            copy = self.copied(Path(name) / "project")
            try:
                yield copy
            finally:
                if self.server and copy.url:
                    self.server.drop(copy.url)

    def held(self) -> dict[str, Any]:
        """Return what it holds."""
        return held(self.folder, self.url)


class Watched:
    """A command that runs in a project, with a mark by which all of its processes are known."""

    def __init__(self, project: Project, words: tuple[str, ...], scratch: Path) -> None:
        self.mark = uuid.uuid4().hex
        own = {"STUDIES_STORAGE": project.url} if project.url else {}
        self.process = begun_in(project.folder, words, scratch, {"KILLS_MARK": self.mark, **own})

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

    def ended(self) -> tuple[int, str, str]:
        """Wait for its end; return exit code, what it answered and what it said on standard error."""
        answer, said = self.process.communicate(timeout=LIMIT_S)
        return self.process.returncode, answer, said

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


def attacked(
    words: tuple[str, ...], before: Project, after: dict[str, Any], took_s: float, draw: random.Random
) -> tuple[int, str]:
    """Kill a command twice, type it again; return the kills that met it alive, and what is wrong or ""."""
    with before.lent() as project:
        scratch, n_kills = project.folder.parent / "tmp", 0
        for _ in range(2):
            command = Watched(project, words, scratch)
            time.sleep(draw.uniform(0.05, took_s))
            n_kills += command.kill(draw)
            command.ended()
            if left := command.left():
                return n_kills, f"processes are left: {left}"
        for _ in range(3):
            command = Watched(project, words, scratch)
            code, answer, said = command.ended()
            if not code or is_finished_before(words, code, said):
                break
        else:
            return n_kills, f"exit code {code}: {said[-300:]}"
        if "Traceback" in said:
            return n_kills, f"a traceback: {said[-300:]}"
        if left := command.left():
            return n_kills, f"processes are left: {left}"
        if files := half_files(project.folder, scratch):
            return n_kills, f"files are left: {files[:5]}"
        if runs := open_runs(project.folder, project.url):
            return n_kills, f"runs of MLflow are left open: {runs[:5]}"
        return n_kills, "; ".join(wrong_of(after, project.held() | answered(answer, project))[:10])


def check_that_it_sees(project: Project) -> None:
    """Spoil a copy of a finished project in three places, and stop unless each is seen.

    Raises:
        AssertionError: What this script compares does not hold what the project holds.
    """
    after = project.held()
    with project.lent() as copy:
        assert not wrong_of(after, copy.held()), "a copy is the same"
        store = next((copy.folder / "data").rglob("*.db"))
        with contextlib.closing(sqlite3.connect(store)) as database, database:
            database.execute("delete from simulations where _id = (select max(_id) from simulations)")
        record = copy.folder / "mlruns" / "results" / "wall-smoke" / "calibrate-adaptive.json"
        content = json.loads(record.read_text())
        content["result"]["mse"] *= 1.001
        record.write_text(json.dumps(content))
        engine = sqlalchemy.create_engine(ProjectPaths(copy.folder, copy.url).optuna_url)
        with engine.begin() as connection:
            connection.execute(sqlalchemy.text("update trial_values set value = value * 1.001"))
        engine.dispose()
        seen = wrong_of(after, copy.held())
        for what in ("1 rows lost", "calibrate-adaptive.json/result/mse", "trials of "):
            assert any(what in one for one in seen), f"not seen: {what}"


def is_finished_before(words: tuple[str, ...], code: int, said: str) -> bool:
    """Say whether a command refuses to do again what it had finished when it was killed.

    That is `new`, which overwrites nothing: killed after its last write it finds its own case file, which the
    user may have changed meanwhile. That all of its files are there and whole is checked like any other.
    """
    return words[0] == "new" and code == 2 and "case.toml exists and is never overwritten" in said


def answered(answer: str, project: Project) -> dict[str, Any]:
    """Return the numbers that a command with `--json` answers."""
    answer = answer.replace(str(project.folder), "project")
    if project.url:
        answer = answer.replace(f"/{project.url.rpartition('/')[2]}?", "/database?")
    return {"answer": numbers_of(json.loads(answer))} if answer.startswith("{") else {}


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=int(os.environ.get("KILLS_SEED", "0")))
    parser.add_argument("--only", help="the commands of this name alone")
    parser.add_argument("--postgresql", action="store_true", help="trials and runs are on a server")
    chosen = parser.parse_args()
    with contextlib.ExitStack() as stack:
        server = PostgresServer() if chosen.postgresql else None
        if server:
            stack.callback(server.close)
        top = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="command-kills-")))
        return killed(chosen, server, top)


def killed(chosen: argparse.Namespace, server: PostgresServer | None, top: Path) -> int:
    """Run all commands in a project, then kill them in copies of it; return 1 where something is wrong."""
    draw, n_wrong, n_kills = random.Random(chosen.seed), 0, 0
    project = Project(top / "project", server, server.new_database() if server else None)
    for place in ("fmus/wall", "data/wall"):
        shutil.copytree(ROOT / place, project.folder / place, ignore=shutil.ignore_patterns("generated"))
    (project.folder / "studies.toml").write_text("schema = 1\n")
    states = []
    for number, words in enumerate(COMMANDS):
        before = project.copied(top / f"before-{number}")
        began = time.monotonic()
        code, answer, said = Watched(project, words, top / "tmp").ended()
        assert code == 0, f"{words}: {said}"
        states.append((words, before, project.held() | answered(answer, project), time.monotonic() - began))
        print(f"{states[-1][3]:.1f} s without a kill: {' '.join(words)}", flush=True)
    check_that_it_sees(project)
    states = [state for state in states if chosen.only in (None, state[0][0])]
    seen: dict[tuple[str, ...], list[tuple[int, str]]] = {state[0]: [] for state in states}
    for words, before, after, took_s in itertools.cycle(states):
        n, wrong = attacked(words, before, after, took_s, draw)
        seen[words].append((n, wrong))
        n_kills += n
        n_wrong += bool(wrong)
        print(f"{n_kills} kills, {' '.join(words)}: {f'WRONG {wrong}' if wrong else 'good'}", flush=True)
        if n_kills >= chosen.kills:
            break
    for words, found in seen.items():
        n, n_bad = sum(n for n, _ in found), sum(bool(wrong) for _, wrong in found)
        print(f"{n:3d} kills, {n_bad} wrong: {' '.join(words)}")
    print(f"{n_kills} kills: {'good' if not n_wrong else f'{n_wrong} BAD'}")
    return bool(n_wrong)


if __name__ == "__main__":
    sys.exit(main())
