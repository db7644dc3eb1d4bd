"""Kill workers of one study and count what is left: `python tests/benchmarks/worker_kills.py`.

Three workers share a study of 60 trials on the case `wall`, in a project of their own. They are killed 20
times by SIGKILL. The command is typed again where it gives up. Prints one line; exits 1 where a place of the
study has not ended once, or Optuna and MLflow disagree. `--postgres` needs PostgreSQL's programs.
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import optuna
import psutil

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from studies.paths import ProjectPaths  # noqa: E402
from studies.tracking.runs import RunStore  # noqa: E402
from studies.tuning.attempts import OWNER, place_of, places  # noqa: E402
from studies.tuning.storage import storage_of  # noqa: E402


def killed(root: Path, *, n_trials: int, n_kills: int, seed: int, storage: str | None) -> bool:
    """Tune while workers are killed, then look at what is left."""
    draw, n_killed, n_commands = random.Random(seed), 0, 0
    paths = ProjectPaths(root, storage)
    words = ["tune", "wall", "--profile", "smoke", "--n-train", "32", "--trials", str(n_trials)]
    words += ["--parallel", "3", "--jobs", "3", "-q"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), **({"STUDIES_STORAGE": storage} if storage else {})}
    began = time.monotonic()
    while True:
        n_commands += 1
        command = subprocess.Popen(
            [sys.executable, "-P", "-m", "studies", *words],
            cwd=root,
            env=environment,
            stdout=subprocess.DEVNULL,
        )
        while command.poll() is None:
            time.sleep(draw.uniform(0.05, 1.0))
            busy = pids_of_trials(paths)
            children = psutil.Process().children(recursive=True)
            workers = [one for one in children if one.pid in busy and "studies.tuning.worker" in said(one)]
            if workers and n_killed < n_kills and command.poll() is None:
                draw.choice(workers).kill()
                n_killed += 1
        if command.returncode == 0:
            break
    with storage_of(paths) as opened:
        (name,) = [one for one in optuna.get_all_study_names(opened) if "pca-gp" not in one]
        trials = optuna.load_study(study_name=name, storage=opened).get_trials()
    ended = Counter(trial.state.name for trial in places(trials))
    runs = RunStore(paths)
    found = runs.find("wall-smoke", {"role": "trial", "study": name})
    wrong = [
        (run.data.tags["trial"], run.info.status, trials[int(run.data.tags["trial"])].state.name)
        for run in found
        if run.info.status != {"COMPLETE": "FINISHED", "PRUNED": "FINISHED"}.get(
            trials[int(run.data.tags["trial"])].state.name, "FAILED"
        )
    ]  # fmt: skip
    doubled = len(places(trials)) - len({place_of(trial, trials) for trial in places(trials)})
    is_good = sum(ended.values()) == n_trials and not (set(ended) & {"RUNNING", "WAITING"}) and not wrong
    print(
        f"{'PostgreSQL' if storage else 'SQLite'}: {n_killed} kills, {n_commands} commands, "
        f"{time.monotonic() - began:.0f} s; {len(trials)} attempts at {len(places(trials))} places: "
        f"{dict(ended)}; "
        f"{doubled} doubled; {len(found)} MLflow runs, {len(wrong)} of them disagree {wrong or ''}: "
        f"{'good' if is_good and not doubled else 'BAD'}",
        flush=True,
    )
    return is_good and not doubled


def said(process: psutil.Process) -> list[str]:
    """Return a process's command line, nothing where it has gone."""
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def pids_of_trials(paths: ProjectPaths) -> set[int]:
    """Return the processes that have reserved or begun a trial which has not ended."""
    if paths.storage is None and not paths.optuna_database.is_file():
        return set()
    with storage_of(paths) as storage:
        studies = [
            optuna.load_study(study_name=n, storage=storage) for n in optuna.get_all_study_names(storage)
        ]
        trials = [trial for study in studies for trial in study.get_trials(deepcopy=False)]
    return {
        trial.user_attrs[OWNER]["pid"]
        for trial in trials
        if OWNER in trial.user_attrs and not trial.state.is_finished()
    }


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--postgres", action="store_true")
    chosen = parser.parse_args()
    budget = {"n_trials": chosen.trials, "n_kills": chosen.kills, "seed": chosen.seed}
    with tempfile.TemporaryDirectory(prefix="worker-kills-") as root:
        Path(root).chmod(0o755)
        if not chosen.postgres:
            return not killed(Path(root), storage=None, **budget)
        from postgres_for_tests import PostgresServer

        server = PostgresServer()
        try:
            return not killed(Path(root), storage=server.new_database(), **budget)
        finally:
            server.close()


if __name__ == "__main__":
    sys.exit(main())
