"""What tests share: a small project with the real office FMU, a whole run in it, and answers of commands."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pandas
import psutil
import pytest
from made_up_recording import write_csv_files
from mlflow_store_for_tests import give_store

REPOSITORY = Path(__file__).resolve().parents[1]
OFFICE = REPOSITORY / "fmus" / "office"
SMOKE_RUN = (sys.executable, "-m", "studies", "run", "--profile", "smoke", "--jobs", "2")
DAY = ("--window", "1-2")  # to say how sure it is takes a simulation's length of time
LIMIT_S = 600.0
AGAIN_S = 60.0  # then Ctrl-C is pressed again
HOSTILE = ("mlflow", "multiprocessing", "numpy", "pickle", "random", "signal", "socket", "uvicorn")


class Answer:
    """What a command answered.

    Args:
        code: exit code.
        out: stdout.
        err: stderr.
    """

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def document(self) -> dict[str, Any]:
        content = json.loads(self.out)
        assert isinstance(content, dict)
        return content

    @property
    def stage(self) -> dict[str, Any]:
        """The one stage of a command that went well."""
        assert self.code == 0, self.err
        (stage,) = self.document["stages"]
        assert isinstance(stage, dict)
        return stage


Run = Callable[..., Answer]


def make_calibrated_wall(root: Path, *options: str) -> None:
    """Make a project with a wall and calibrate it with some options, quietly, in one process."""
    from studies.cli import main

    add_case(make_project(root))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        assert main(["calibrate", "wall", "--jobs", "1", "-q", *options]) == 0


def add_case(root: Path, name: str = "wall") -> Path:
    """Copy an embedded case and its data into a project; return the case file."""
    for room in ("fmus", "data"):
        ignore = shutil.ignore_patterns("generated")
        shutil.copytree(REPOSITORY / room / name, root / room / name, ignore=ignore)
    return root / "fmus" / name / "case.toml"


def make_judged_wall(root: Path) -> None:
    """Make a project with a wall that was calibrated on a day and whose uncertainty is known."""
    from studies.cli import main

    make_calibrated_wall(root, *DAY)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        assert main(["uncertainty", "wall", *DAY, "--max-calls", "30", "--jobs", "1", "-q"]) == 0


def edit(file: Path, *pairs: tuple[str, str]) -> Path:
    """Put new texts in the place of the first of old ones in a file; return it."""
    text = file.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text, f"{old!r} is not in {file}"
        text = text.replace(old, new, 1)
    file.write_text(text, encoding="utf-8")
    return file


def copy_of(template: Path, root: Path, patch: pytest.MonkeyPatch) -> Path:
    """Copy a project and let the command line find the copy."""
    shutil.copytree(template, root)
    patch.chdir(root)
    return root


def stored_simulations(project: Path, case: str = "office") -> dict[str, pandas.DataFrame]:
    """Return the rows of a case's stores, by the name of the file; read as users read them."""
    found = {}
    for file in sorted(project.glob(f"data/{case}/generated/simulations/*.db")):
        with closing(sqlite3.connect(file)) as database:
            found[file.name] = pandas.read_sql("select * from simulations", database)
    return found


def stored_result(
    project: Path, stage: str = "calibrate-adaptive", label: str = "wall-quick"
) -> dict[str, Any]:
    """Return what a stage found, without how many rows were simulated: that depends on what is stored."""
    file = project / "mlruns" / "results" / label / f"{stage}.json"
    content = json.loads(file.read_text(encoding="utf-8"))["result"]
    assert isinstance(content, dict)
    return {name: value for name, value in content.items() if name != "n_simulated"}


def make_project(root: Path, *, with_store: bool = True) -> Path:
    """Lay out a project with the office, a made-up recording of 22 days and perhaps an empty MLflow store."""
    folder = root / "fmus" / "office"
    folder.mkdir(parents=True)
    for name in ("Office.fmu", "case.toml"):
        shutil.copy(OFFICE / name, folder / name)
    write_csv_files(root / "data" / "office")
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    if with_store:
        give_store(root)
    return root


def make_validated_project(root: Path) -> Path:
    """Make a project whose office is validated on days 10 to 12 and was not measured on day 2."""
    make_project(root)
    case = root / "fmus" / "office" / "case.toml"
    text = case.read_text(encoding="utf-8")
    assert "start_d = 0 " in text
    case.write_text(text.replace("[time]\n", "[time]\nvalidation_d = [10, 12]\n"), encoding="utf-8")
    recording = root / "data" / "office" / "recording_1800s.csv"
    lines = recording.read_text(encoding="utf-8").splitlines()
    for row in range(101, 149):
        cells = lines[row].split(",")
        lines[row] = ",".join([cells[0], "", *cells[2:]])
    recording.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return root


def make_hostile(folder: Path) -> Path:
    """Make a working folder with files named like modules; one that is imported makes a file `caught`."""
    folder.mkdir()
    for name in HOSTILE:
        trap = f"import os\nos.open({str(folder / 'caught')!r}, os.O_CREAT)\nraise SystemExit('{name} ran')\n"
        (folder / f"{name}.py").write_text(trap)
    return folder


def process_environment(project: Path) -> dict[str, str]:
    """Return the environment of a command in a project, in a process of its own."""
    # A command that ran in this process has set it.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    return environment | {
        "STUDIES_ROOT": str(project),
        "PYTHONPATH": str(REPOSITORY),
        "OMP_NUM_THREADS": "1",
    }


def finish(project: Path) -> None:
    """Run to the end, in this process."""
    from studies.cli import main

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        assert main(SMOKE_RUN[3:]) == 0


def interrupt(
    words: Sequence[str],
    project: Path,
    how: signal.Signals,
    is_moment: Callable[[Path, str], bool],
    *,
    folder: Path | None = None,
) -> tuple[int, str]:
    """Start a command, interrupt it at a moment, and return its exit code and what it said."""
    log = project / "stderr.txt"
    with log.open("w") as stderr:
        process = subprocess.Popen(
            words,
            cwd=folder or project,
            env=process_environment(project),
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,
        )
        deadline = time.monotonic() + LIMIT_S
        while not is_moment(project, log.read_text()):
            assert process.poll() is None, f"the command ended before its moment came:\n{log.read_text()}"
            assert time.monotonic() < deadline
            time.sleep(0.02)  # oftener would take the run's processor
        if how is signal.SIGINT:
            # a terminal sends Ctrl-C to the whole group, workers included
            os.killpg(process.pid, how)
            with suppress(subprocess.TimeoutExpired):  # Python drops one of 300
                process.wait(AGAIN_S)
            if process.poll() is None:
                os.killpg(process.pid, how)
        else:
            process.kill()
        code = process.wait(LIMIT_S)
    # Its workers are of its session; the one that simulations are forked from is not.
    left = [one for one in psutil.process_iter() if _session(one) == process.pid]
    assert not psutil.wait_procs(left, timeout=100.0)[1], "a process outlives its command"
    return code, log.read_text()


def _session(process: psutil.Process) -> int | None:
    """Return the number of a process's session, None where it has just ended."""
    try:
        return os.getsid(process.pid)
    except ProcessLookupError:
        return None
