"""Two commands at once in one project, and what is wrong with it afterwards."""

import shutil
import sqlite3
import subprocess
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from held_for_tests import REPOSITORY, begun_in, half_files, held, open_runs, wrong_of

LIMIT_S = 600.0
PROFILE = """schema = 1
name = "tiny"
[data]
n_train = [8]
n_validation = 8
n_test = 8
[sensitivity]
n_base = 2
n_resamples = 2
[tuning]
surrogate = "refined"
n_trials = 2
max_epochs = 3
patience = 3
[tuning.search]
n_latent = { kind = "int", low = 4, high = 8, log = true }
[screening]
popsize = 2
maxiter = 2
[polish]
max_calls = 9
ftol = 1e-1
"""
TASK = ("wall", "--profile", "tiny.toml", "--window", "1-2", "--jobs", "1", "-q")
CALIBRATE = ("calibrate", *TASK, "--max-calls", "12", "--no-state-equations")
COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", *TASK),
    "tune": ("tune", *TASK),
    "calibrate": (*CALIBRATE, "--again"),
    "uncertainty": ("uncertainty", *TASK, "--max-calls", "30"),
    "predict": ("predict", *TASK, "--inputs", "data/wall/inputs.csv"),
    "report": ("report", *TASK),
    "best": ("best", "--json"),
    "simulate": ("simulate", *TASK),
}
"""In a project with a calibration each of them has something to do."""
SIMULATING = {"run", "tune", "calibrate", "simulate"}
"""An uncertainty begins with what these have stored at that moment, which is noted and not chosen anew."""


def make_base(root: Path) -> None:
    """Make a project with a calibration of a day of the wall, and nothing else."""
    for place in ("fmus/wall", "data/wall"):
        shutil.copytree(REPOSITORY / place, root / place, ignore=shutil.ignore_patterns("generated"))
    case = root / "fmus" / "wall" / "case.toml"
    lines = case.read_text(encoding="utf-8").splitlines(keepends=True)
    case.write_text("".join(one for one in lines if not one.startswith("validation_d")), encoding="utf-8")
    (root / "studies.toml").write_text("schema = 1\n")
    (root / "tiny.toml").write_text(PROFILE)
    answered(begun(root, CALIBRATE))


def begun(project: Path, words: tuple[str, ...], before: tuple[str, ...] = ()) -> "subprocess.Popen[str]":
    """Begin a command in a project, perhaps under another program."""
    own = {"OMP_NUM_THREADS": "1"}
    return begun_in(project, words, project.parent / "tmp", own, before=before)


def answered(process: "subprocess.Popen[str]") -> str:
    """Wait for a command that goes well, and return what it said on standard error."""
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, f"{process.args}: exit code {process.returncode}: {said}"
    return said


@dataclass(frozen=True)
class Alone:
    """What a project holds after one command.

    Attributes:
        before: What it held before.
        after: What it holds then.
    """

    before: dict[str, Any]
    after: dict[str, Any]

    @classmethod
    def of(cls, base: Path, name: str, folder: Path) -> "Alone":
        """Type a command in a copy of a project.

        Args:
            base: The project.
            name: Which command.
            folder: An empty one for the copy.
        """
        project = shutil.copytree(base, folder / "project")
        before = held(project)
        answered(begun(project, COMMANDS[name]))
        assert not (wrong := _left(project, folder)), wrong
        return cls(before, held(project))


def wrong_of_pair(base: Path, pair: tuple[str, str], alone: dict[str, Alone], folder: Path) -> list[str]:
    """Type two commands at once, then both again one by one; say what is wrong.

    Args:
        base: A project to be copied.
        pair: Which commands.
        alone: What each of them does alone.
        folder: An empty one for the copy.
    """
    project, wrong = shutil.copytree(base, folder / "project"), []
    processes = [begun(project, COMMANDS[name]) for name in pair]
    for name, process in zip(pair, processes, strict=True):
        answer, said = process.communicate(timeout=LIMIT_S)
        lines = said.splitlines()
        if process.returncode not in (0, 2) or "Traceback" in said + answer:
            wrong.append(f"{name}: exit code {process.returncode}: {said[-500:]}")
        if process.returncode == 2 and len(lines) != 1:
            wrong.append(f"{name}: refuses in {len(lines)} lines: {said[-500:]}")
    between = held(project)
    for name in pair:
        again = tuple(word for word in COMMANDS[name] if word != "--again")
        process = begun(project, again)
        _, said = process.communicate(timeout=LIMIT_S)
        if process.returncode or "Traceback" in said:
            wrong.append(f"{name} once more: exit code {process.returncode}: {said[-500:]}")
    expected = dict[str, Any]()
    for name in pair:
        changed = {k: v for k, v in alone[name].after.items() if v != alone[name].before.get(k)}
        expected = alone[name].before | expected | changed
    others = [name for name in pair if name != "uncertainty"]
    if "uncertainty" in pair and SIMULATING & {*others}:
        expected |= {name: one for name, one in between.items() if _is_of("uncertainty", name)}
        expected["rows"] = between["rows"].union(*(alone[name].after["rows"] for name in others))
    else:
        expected["rows"] = set.union(*(alone[name].after["rows"] for name in pair))
    if {*pair} == {"uncertainty", "predict"}:
        # A prediction has bands once there is an uncertainty.
        expected |= {name: one for name, one in _banded(base, folder).items() if _is_of("predict", name)}
    now = held(project)
    return [*wrong, *wrong_of(expected, now)[:10], *_left(project, folder)]


def _is_of(command: str, name: str) -> bool:
    """Say whether a result is of a command."""
    return name.startswith("mlruns/results/") and Path(name).name.startswith(f"{command}-")


def _banded(base: Path, folder: Path) -> dict[str, Any]:
    """Return what a project holds after an uncertainty and then a prediction."""
    project = shutil.copytree(base, folder / "one-by-one" / "project")
    for name in ("uncertainty", "predict"):
        answered(begun(project, COMMANDS[name]))
    return held(project)


def _left(project: Path, folder: Path) -> list[str]:
    """Say what is doubled, open or half."""
    wrong = [f"left open: {name}" for name in open_runs(project)]
    wrong += [f"left: {file}" for file in half_files(project, folder / "tmp")]
    with closing(sqlite3.connect(project / "mlruns" / "mlflow.db")) as database:
        marks: dict[str, dict[str, str]] = {}
        query = "select run_uuid, key, value from tags join runs using (run_uuid) where status = 'FINISHED'"
        for run, key, value in database.execute(query):
            marks.setdefault(run, {})[key] = value
    named = ("label", "role", "stage_key", "study", "trial", "mlflow.runName")
    runs = Counter(tuple(one.get(name, "") for name in named) for one in marks.values())
    return wrong + [f"{n} runs of MLflow are one: {run}" for run, n in runs.items() if n > 1]
