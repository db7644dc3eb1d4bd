"""Three users on one MLflow server and one PostgreSQL: `python tests/benchmarks/three_users.py`.

Two of them share a project, each with a size of its own; the third has another project with the same case
and profile. Each tunes 20 trials. Meanwhile commands and workers are killed, PostgreSQL is restarted after a
pause, and the MLflow server is killed and started again. Each command is typed again until it succeeds.
Trials must be those of projects in which nothing was disturbed, and the server must have each run once. Exits
1 otherwise. Takes some ten minutes.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from mlflow_server_for_tests import MlflowServer  # noqa: E402
from postgres_for_tests import PostgresServer  # noqa: E402

N_TRIALS = 20
# Project, training-set size, seed.
USERS = (("one", "16", "0"), ("one", "32", "0"), ("two", "16", "1"))
LIMIT_S = 1800.0


def make_project(root: Path) -> None:
    """Make a project with the embedded wall."""
    for place in ("fmus/wall", "data/wall"):
        shutil.copytree(ROOT / place, root / place, ignore=shutil.ignore_patterns("generated"))
    (root / "studies.toml").write_text("schema = 1\n")


def words_of(size: str, seed: str) -> list[str]:
    """Return the command of a user."""
    words = ["tune", "wall", "--profile", "smoke", "--n-train", size, "--seed", seed]
    return [*words, "--trials", str(N_TRIALS), "--jobs", "1", "-q"]


def typed(project: Path, words: list[str], more: dict[str, str]) -> "subprocess.Popen[str]":
    """Begin a command in a project."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "studies", *words],
        cwd=project,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | more,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def trials_of(projects: dict[str, Path], url: str | None) -> dict[str, list[Any]]:
    """Return the ended trials of each study of all projects, by project, label and size."""
    from studies.paths import ProjectPaths
    from studies.tuning.study_results import read_studies

    found: dict[str, list[Any]] = {}
    for project, root in projects.items():
        for study in read_studies(ProjectPaths(root, url)):
            spec, states = study.spec, {one.state for one in study.trials}
            assert not states & {"running", "waiting"}, f"{spec.name}: a trial is left open"
            kind = " baseline" if spec.is_baseline else ""
            found[f"{project}: {spec.label}, n = {spec.n_train}{kind}"] = [
                (sorted(one.params.items()), one.state, one.value, sorted(one.metrics.items()))
                for one in study.trials
                if one.state != "failed"
            ]
    return found


def server_differs(projects: dict[str, Path], url: str, uri: str) -> list[str]:
    """Say where the server's runs are not those of the projects."""
    import mlflow

    from studies.paths import ProjectPaths
    from studies.tracking.quiet_mlflow import connect
    from studies.tracking.study_tags import RUN

    wrong = []
    for project, root in projects.items():
        paths = ProjectPaths(root, url)
        every = []
        for client in (connect(paths.tracking_uri), mlflow.MlflowClient(uri, uri)):
            places = [one.experiment_id for one in client.search_experiments()]
            mine = f"tags.`studies.project` = '{paths.identity}'"
            every.append(client.search_runs(places, mine, max_results=5000))
        here = {one.info.run_id: one for one in every[0]}
        there = [one.data.tags[RUN] for one in every[1]]
        if len(set(there)) != len(there) or set(there) != set(here):
            wrong.append(
                f"{project}: {len(here)} runs, on the server {len(there)}, of {len(set(there))} runs"
            )
        for one in every[1]:
            own = here.get(one.data.tags[RUN])
            if own and (own.data.metrics, own.info.status) != (one.data.metrics, one.info.status):
                wrong.append(f"{project}: run {own.info.run_id} has other numbers on the server")
    return wrong


def disturbed(
    projects: dict[str, Path], more: dict[str, str], draw: random.Random, disturb: list[Any]
) -> int:
    """Run all users' commands until each has succeeded; return how many kills met one alive."""
    running = {user: typed(projects[user[0]], words_of(*user[1:]), more) for user in USERS}
    n_kills, next_s, deadline = 0, time.monotonic() + 15.0, time.monotonic() + LIMIT_S
    while running:
        assert time.monotonic() < deadline, "not finished"
        time.sleep(0.5)
        for user, command in list(running.items()):
            code = command.poll()
            if code is None:
                continue
            said = command.communicate()[1]
            assert "Traceback" not in said, said
            if code:
                print(f"  {user}: exit code {code}: {said.strip()[-200:]}", flush=True)
                running[user] = typed(projects[user[0]], words_of(*user[1:]), more)
            else:
                del running[user]
        if time.monotonic() < next_s or not running or not disturb:
            continue
        what = disturb.pop()
        if callable(what):
            what()
        else:
            command = draw.choice(list(running.values()))
            children = psutil.Process(command.pid).children(recursive=True) if command.poll() is None else []
            victim = draw.choice([command.pid, *(one.pid for one in children)])
            try:
                os.kill(victim, signal.SIGKILL)
                n_kills += 1
            except ProcessLookupError:
                disturb.append(what)
        next_s = time.monotonic() + draw.uniform(1.5, 4.5)
    return n_kills


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--pause", type=float, default=25.0, help="how long PostgreSQL is away [s]")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    draw = random.Random(chosen.seed)
    with tempfile.TemporaryDirectory(prefix="three-users-") as name:
        quiet, loud = ({key: Path(name) / kind / key for key in ("one", "two")} for kind in ("quiet", "loud"))
        for root in (*quiet.values(), *loud.values()):
            make_project(root)
        began = time.monotonic()
        for user in USERS:
            command = typed(quiet[user[0]], words_of(*user[1:]), {})
            assert command.communicate()[1] is not None
            assert command.returncode == 0
        expected = trials_of(quiet, None)
        print(
            f"undisturbed: {sum(map(len, expected.values()))} trials, {time.monotonic() - began:.0f} s",
            flush=True,
        )
        postgres = PostgresServer()
        server = MlflowServer(Path(name) / "server", database=postgres.new_database())
        try:
            url = postgres.new_database()
            more = {"STUDIES_STORAGE": url, "MLFLOW_TRACKING_URI": server.uri}

            def restart_postgres() -> None:
                print(f"  PostgreSQL is away for {chosen.pause:g} s", flush=True)
                postgres.restart(chosen.pause)

            def restart_server() -> None:
                print("  the MLflow server is killed and started", flush=True)
                server.kill()
                time.sleep(5.0)
                server.start()

            steps: list[Any] = ["kill"] * chosen.kills + [restart_postgres, restart_server] * 2
            draw.shuffle(steps)
            n_kills = disturbed(loud, more, draw, steps)
            for user in USERS:  # what could not be sent is sent
                command = typed(loud[user[0]], words_of(*user[1:]), more)
                said = command.communicate()[1]
                assert command.returncode == 0, said
            now = trials_of(loud, url)
            wrong = [
                f"{key}: other trials"
                for key in sorted({*now, *expected})
                if now.get(key) != expected.get(key)
            ]
            wrong += server_differs(loud, url, server.uri)
        finally:
            server.close()
            postgres.close()
    print(f"{n_kills} kills, {len(steps)} disturbances left over, {sum(map(len, now.values()))} trials")
    print("\n".join(wrong) or "good: no trial lost, doubled or different; the server has each run once")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
