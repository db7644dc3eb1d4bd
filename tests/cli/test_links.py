"""Nothing is written through a link that leads out of a project, which may be a stranger's."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from project_for_tests import Run, copy_of

from simulation.errors import InputError
from simulation.write_gate import FOLLOW_VARIABLE, check_database, check_written, guard_project
from studies.paths import ProjectPaths
from studies.tuning.storage import open_storage

LABEL = "wall-quick"
CALIBRATE = ("calibrate", "wall", "--max-calls", "8", "--again", "--jobs", "1", "-q")
REPORT = ("report", "wall", "-q")
NEW = ("new", "fmus/wall/Wall.fmu", "--to", "fmus/own", "-q")
BESIDE = ("", "-wal", "-shm", "-journal")
PLACES = {
    "mlruns": CALIBRATE,
    **{f"mlruns/optuna.db{ending}": ("status",) for ending in BESIDE},
    **{f"mlruns/mlflow.db{ending}": ("ui",) for ending in BESIDE},
    "mlruns/.optuna.lock": ("status",),
    "mlruns/.mlflow.lock": CALIBRATE,
    "mlruns/ui.log": ("ui",),
    "mlruns/artifacts": CALIBRATE,
    f"mlruns/artifacts/{LABEL}": REPORT,
    "mlruns/results": CALIBRATE,
    f"mlruns/results/{LABEL}": CALIBRATE,
    f"mlruns/results/{LABEL}/calibrate-adaptive.json": CALIBRATE,
    "mlruns/reports": REPORT,
    f"mlruns/reports/{LABEL}": REPORT,
    f"mlruns/reports/{LABEL}/index.html": REPORT,
    "data/wall/generated": CALIBRATE,
    "data/wall/generated/simulations": CALIBRATE,
    "data/wall/generated/simulations/*.db": CALIBRATE,
    "data/own": NEW,
    "fmus/own": NEW,
    "exports": ("best", "wall", "--write", "ssv", "exports/wall.ssv"),
}
"""What may be a link, and a command that would write there."""
MADE = {
    **{
        place: PLACES[place] for place in ("mlruns", "mlruns/.optuna.lock", "mlruns/ui.log", "mlruns/reports")
    },
    **{place: PLACES[place] for place in ("data/wall/generated", "data/wall/generated/simulations/*.db")},
    **dict.fromkeys(("data/own", "data/own/README.md", "fmus/own", "fmus/own/case.toml"), NEW),
    "mlruns/mlflow.db": CALIBRATE,
    "data/office-recorded": ("import-recording", "data/office", "-q"),
}
"""The same where a command makes what is missing."""


def listing(folder: Path) -> dict[Path, bytes | None]:
    return {one: one.read_bytes() if one.is_file() else None for one in folder.rglob("*")}


@pytest.fixture
def calibrated(hasty_wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a calibration, whose Optuna has a database, too."""
    root = copy_of(hasty_wall, tmp_path / "project", monkeypatch)
    open_storage(ProjectPaths(root)).engine.dispose()
    return root


def replace_by_link(place: Path, outside: Path, *, leads_nowhere: bool = False) -> None:
    """Put a link to a file or folder outside where a project has or would have one."""
    outside.mkdir()
    if place.exists():
        place.rename(outside / "canary")
    elif "." in place.name:
        (outside / "canary").write_text("precious")
    else:
        (outside / "canary").mkdir()
    place.parent.mkdir(parents=True, exist_ok=True)
    place.symlink_to(outside / ("nothing" if leads_nowhere else "canary"))


@pytest.mark.parametrize("place", PLACES)
def test_a_link_out_of_the_project_is_not_written_through(
    place: str, calibrated: Path, tmp_path: Path, studies: Run
) -> None:
    link, outside = next(iter(calibrated.glob(place)), calibrated / place), tmp_path / "outside"
    replace_by_link(link, outside)
    before = listing(outside)
    answer = studies(*PLACES[place])
    assert listing(outside) == before
    assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
    assert f"{link}: this link leads out of the project" in answer.err
    assert f"{FOLLOW_VARIABLE}=1" in answer.err


@pytest.mark.parametrize("place", MADE)
def test_a_link_that_leads_nowhere_makes_nothing_outside(
    place: str, calibrated: Path, tmp_path: Path, studies: Run
) -> None:
    link, outside = next(iter(calibrated.glob(place)), calibrated / place), tmp_path / "outside"
    replace_by_link(link, outside, leads_nowhere=True)
    before = listing(outside)
    answer = studies(*MADE[place])
    assert listing(outside) == before
    assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
    assert f"{link}: this link leads out of the project" in answer.err


def test_the_user_allows_links(
    calibrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    replace_by_link(calibrated / "mlruns", tmp_path / "outside")
    monkeypatch.setenv(FOLLOW_VARIABLE, "1")
    assert studies(*REPORT).code == 0
    assert (tmp_path / "outside" / "canary" / "reports" / LABEL / "index.html").is_file()


def test_links_within_a_project_and_to_it_are_followed(
    calibrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    (calibrated / "mlruns").rename(calibrated / "kept")
    (calibrated / "mlruns").symlink_to("kept")
    (tmp_path / "link").symlink_to(calibrated)
    monkeypatch.chdir(tmp_path / "link")
    monkeypatch.setenv("PWD", str(tmp_path / "link"))
    assert studies(*REPORT).code == 0
    assert (calibrated / "kept" / "reports" / LABEL / "index.html").is_file()


def test_what_the_user_names_may_lie_anywhere(calibrated: Path, tmp_path: Path, studies: Run) -> None:
    (tmp_path / "outside").mkdir()
    (tmp_path / "link").symlink_to("outside")
    for place in (str(tmp_path / "link" / "a.ssv"), "../link/b.ssv"):
        assert studies("best", "wall", "--write", "ssv", place).code == 0
    assert {one.name for one in (tmp_path / "outside").iterdir()} == {"a.ssv", "b.ssv"}


def test_a_way_back_over_a_link_is_one_out_of_the_project(tmp_path: Path) -> None:
    project = tmp_path / "project"
    (project / "folder").mkdir(parents=True)
    (tmp_path / "a" / "b").mkdir(parents=True)
    (project / "link").symlink_to(tmp_path / "a" / "b")
    guard_project(project)
    check_written(project / "folder" / ".." / "file")
    check_written(project / ".." / "file")
    with pytest.raises(InputError, match="leads out of the project"):
        check_written(project / "link" / ".." / "file")


def test_a_journal_that_names_another_file_is_not_given_to_sqlite(tmp_path: Path) -> None:
    """SQLite would delete the file that it names: seen with 3.40 to 3.46."""
    database = tmp_path / "x.db"
    check_database(database)
    (tmp_path / "x.db-journal").write_bytes(b"")
    check_database(database)
    (tmp_path / "x.db-journal").write_bytes(bytes(600) + bytes.fromhex("d9d505f920a163d7"))
    with pytest.raises(InputError, match="names another file, which SQLite would delete"):
        check_database(database)


DOCTORED = {
    "update experiments set artifact_location = 'http://127.0.0.1:9/' where name <> 'Default'": "http://127",
    "update experiments set artifact_location = 'http://127.0.0.1:9/'": "http://127",
    "update runs set artifact_uri = 'file://{outside}'": "file:///",
    "update runs set artifact_uri = '{outside}'": "outside",
    "create trigger t after insert on runs begin update runs set artifact_uri = 'http://x'; end": "trigger",
}


@pytest.mark.parametrize("statement", DOCTORED)
def test_a_doctored_store_is_refused(
    statement: str, calibrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    with closing(sqlite3.connect(calibrated / "mlruns" / "mlflow.db")) as store, store:
        store.execute(statement.format(outside=outside))
    for command in (REPORT, ("ui",)):
        answer = studies(*command)
        assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
        assert DOCTORED[statement] in answer.err
        assert "mlflow.db" in answer.err
    assert not [*outside.iterdir()]


def test_a_store_of_artifacts_that_refuses_is_one_line(
    calibrated: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    monkeypatch.setenv(FOLLOW_VARIABLE, "1")
    with closing(sqlite3.connect(calibrated / "mlruns" / "mlflow.db")) as store, store:
        store.execute("update experiments set artifact_location = 'nowhere://x/'")
    answer = studies(*REPORT)
    assert (answer.code, len(answer.err.splitlines())) == (1, 1), answer.err
    assert "cannot be stored" in answer.err
    assert "nowhere://x" in answer.err
