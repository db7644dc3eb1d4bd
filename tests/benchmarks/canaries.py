"""Type all commands in a stranger's folder: `python tests/benchmarks/canaries.py`.

Files and folders of a project are links to canaries outside, or its databases name places outside, hostile
names and numbers of wrong kinds. No canary may change, and each command says one line at most. Where `strace`
is installed, no process may even open a file outside for writing, or connect to a machine that a database
names. Exits 1 otherwise. Takes some 20 minutes.
"""

import argparse
import hashlib
import os
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[1])]

from pairs_for_tests import COMMANDS, TASK, answered, begun, make_base  # noqa: E402

from simulation.write_gate import FOLLOW_VARIABLE  # noqa: E402

LABEL, LIMIT_S = "wall-tiny-d1-2", 300.0
ALL: dict[str, tuple[str, ...]] = {
    **COMMANDS,
    "check": ("check", *TASK, "--again"),
    "sensitivity": ("sensitivity", *TASK, "--fmu"),
    "calibrate (paper)": ("calibrate", *TASK, "--method", "paper", "--n-train", "8", "--again"),
    "profiles": ("uncertainty", *TASK, "--profiles"),
    "next": ("next", *TASK),
    "status": ("status",),
    "write": ("best", "wall", "--write", "csv", "values.csv"),
    "reproduce": ("reproduce", f"{LABEL}/adaptive", "-q"),
    "new": ("new", "fmus/wall/Wall.fmu", "--to", "fmus/own", "-q"),
    "ui": ("ui",),
}
# What a process may do to a file, and the connections that it makes.
CALLS = (
    "openat,open,creat,rename,renameat,renameat2,unlink,unlinkat,rmdir,mkdir,mkdirat,link,linkat,symlink,"
    "symlinkat,truncate,chmod,fchmodat,utimensat,connect"
)
MLFLOW = (
    "update experiments set artifact_location = 'http://127.0.0.1:9/'",
    "update runs set artifact_uri = 'http://127.0.0.1:9/'",
    "update runs set artifact_uri = 'file://{outside}'",
    "update logged_models set artifact_location = '{outside}'",
    "update model_versions set source = '{outside}', storage_location = '{outside}'",
    "create trigger t after insert on runs begin update runs set artifact_uri = '{outside}'; end",
)
OPTUNA = (
    "update trial_user_attributes set value_json = '\"../../../../{outside}\"' where key = 'mlflow_run_id'",
    "update study_user_attributes set value_json = replace(value_json, 'data/wall/', '../../{outside}/')",
    f"update study_user_attributes set value_json = replace(value_json, '\"{LABEL}\"', '\"../../outside\"')",
    "update studies set study_name = '../../outside' || study_id",
    "update trial_values set value = 'x'",
    "update trial_values set value = 1e308",
    "update trial_params set param_value = 1e18",
    "create trigger t after insert on trials begin delete from trials; end",
)


def files_become_links(project: Path, outside: Path) -> None:
    """Put a link in the place of each file that a command made."""
    for place in ("mlruns", "data/wall/generated"):
        for file in [one for one in (project / place).rglob("*") if one.is_file()]:
            canary = outside / file.relative_to(project)
            canary.parent.mkdir(parents=True, exist_ok=True)
            file.rename(canary)
            file.symlink_to(canary)


def folders_become_links(project: Path, outside: Path) -> None:
    """Put a link in the place of the folders that commands write to."""
    for place in ("mlruns", "data/wall/generated", "fmus/own", "data/own"):
        canary = outside / place
        canary.parent.mkdir(parents=True, exist_ok=True)
        if (project / place).exists():
            (project / place).rename(canary)
        else:
            canary.mkdir()
        (project / place).symlink_to(canary)


def doctored(database: str, statement: str) -> Callable[[Path, Path], None]:
    """Return what changes a database of a project."""

    def change(project: Path, outside: Path) -> None:
        (outside / "canary").write_text("precious")
        with closing(sqlite3.connect(project / "mlruns" / database)) as store, store:
            store.execute(statement.format(outside=outside))

    return change


def traps() -> Iterator[tuple[str, Callable[[Path, Path], None], tuple[int, ...]]]:
    """Yield each trap: its name, what sets it, and the exit codes that are right."""
    yield "links: files", files_become_links, (2,)
    yield "links: folders", folders_become_links, (2,)
    for statement in MLFLOW:
        yield f"MLflow: {statement}", doctored("mlflow.db", statement), (0, 2)
    for statement in OPTUNA:
        yield f"Optuna: {statement}", doctored("optuna.db", statement), (0, 2)


def state(folder: Path) -> dict[str, tuple[str, int]]:
    """Return what lies in a folder, with digests and times of change."""
    return {
        str(one.relative_to(folder)): (
            hashlib.sha256(one.read_bytes()).hexdigest() if one.is_file() else "",
            one.lstat().st_mtime_ns,
        )
        for one in folder.rglob("*")
    }


def reached(log: Path, outside: Path) -> list[str]:
    """Return the calls that changed something outside, or might have, or went to the machine of a trap."""
    found = []
    for line in log.read_text(errors="replace").splitlines():
        is_connect = "connect(" in line
        if is_connect and "htons(9)" in line:
            found.append(line)
        if is_connect or " = -1 " in line or not re.search(r"\b(\w+)\(", line):
            continue
        is_open = re.search(r"\b(openat|open)\(", line)
        if is_open and not re.search(r"O_WRONLY|O_RDWR|O_CREAT|O_TRUNC", line):
            continue
        # What was opened stands at the end with all links followed; of other calls the folders are followed.
        named = re.findall(r"= \d+<([^>]*)>", line) if is_open else re.findall(r'"([^"]*)"', line)
        folders = [Path(one) if is_open else Path(one).parent.resolve() / Path(one).name for one in named]
        found += [line] if any(one.is_relative_to(outside) for one in folders) else []
    return found


def wrong_of(
    base: Path,
    words: tuple[str, ...],
    trap: Callable[[Path, Path], None],
    codes: tuple[int, ...],
    folder: Path,
) -> list[str]:
    """Type a command in a copy of a project in which a trap is set; say what is wrong."""
    project, outside, log = folder / "project", (folder / "outside").resolve(), folder / "strace.log"
    outside.mkdir()
    shutil.copytree(base, project)
    trap(project, outside)
    before = state(outside)
    tracer = ("strace", "-f", "-qq", "-y", "-e", f"trace={CALLS}", "-o", str(log))
    process = begun(project, words, tracer if shutil.which("strace") else ())
    try:
        _, said = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return ["it does not end"]
    lines, wrong = said.splitlines(), list[str]()
    if process.returncode not in codes or "Traceback" in said:
        wrong.append(f"exit code {process.returncode}: {said[-300:]}")
    if len(lines) > 1 or (process.returncode and len(lines) != 1):
        wrong.append(f"{len(lines)} lines: {said[-300:]}")
    after = state(outside)
    wrong += [f"changed: {one}" for one in sorted({*before} | {*after}) if before.get(one) != after.get(one)]
    return wrong + (reached(log, outside)[:3] if log.is_file() else [])


def check_that_it_sees(base: Path, folder: Path) -> None:
    """Let a command follow links, and stop unless what it changes outside is seen.

    Raises:
        AssertionError: It is not.
    """
    os.environ[FOLLOW_VARIABLE] = "1"
    seen = wrong_of(base, ALL["calibrate"], files_become_links, (0,), folder)
    del os.environ[FOLLOW_VARIABLE]
    assert any(one.startswith("changed: ") for one in seen), seen
    assert not shutil.which("strace") or any("O_RDWR" in one for one in seen), seen


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="traps whose names begin so")
    parser.add_argument("--command", action="append", help="these commands alone")
    chosen, n_tried, n_wrong = parser.parse_args(), 0, 0
    with tempfile.TemporaryDirectory(prefix="canaries-") as name:
        base = Path(name) / "base"
        make_base(base)
        for command in ("uncertainty", "predict", "run"):
            answered(begun(base, COMMANDS[command]))
        with tempfile.TemporaryDirectory(dir=name) as folder:
            check_that_it_sees(base, Path(folder))
        for which, trap, codes in traps():
            for command, words in ALL.items() if which.startswith(chosen.only) else ():
                # MLflow's page would stay open where nothing is wrong with its store.
                if command not in (chosen.command or ALL) or (command == "ui" and which.startswith("Optuna")):
                    continue
                # Beside links it makes a folder of its own.
                right = (0, *codes) if command == "new" else codes
                with tempfile.TemporaryDirectory(dir=name) as folder:
                    wrong = wrong_of(base, words, trap, right, Path(folder))
                n_tried, n_wrong = n_tried + 1, n_wrong + bool(wrong)
                print(f"{which}; {command}: {f'WRONG {wrong}' if wrong else 'good'}", flush=True)
    print(f"{n_tried} tried: {f'{n_wrong} BAD' if n_wrong else 'good'}")
    return bool(n_wrong)


if __name__ == "__main__":
    sys.exit(main())
