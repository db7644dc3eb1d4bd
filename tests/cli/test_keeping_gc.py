"""`studies gc`: what nothing refers to goes when asked, and nothing else."""

import io
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kept_project import LABEL, bad_findings, contents, copy_project, the_study, trial_folder
from project_for_tests import Run

from simulation.store.row_set import RowSet
from simulation.store.store import SimulationStore
from studies.keeping.mlflow_tables import read_mlflow
from studies.keeping.views import tracker_of
from studies.paths import ProjectPaths
from studies.stages.pipeline import write_json
from studies.tuning.claim import Claim, this_owner
from studies.tuning.trial_store import list_studies, open_trials


@pytest.fixture
def paths(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    return copy_project(finished, tmp_path / "project", monkeypatch)


def add_superseded(paths: ProjectPaths) -> str:
    """Add an older study of the same label and size, with a trial."""
    entry, store = the_study(paths)
    name = f"{LABEL}/n0016/{'0' * 8}"
    other = open_trials(paths, name)
    other.describe(replace(entry, name=name, created_s=entry.created_s - 1000))
    record = store.record(0)
    assert record is not None
    other.write(replace(record, study=name), store.history(0))
    return name


def found(studies: Run, *words: str) -> dict[str, list[str]]:
    """Return what may go, by kind."""
    kinds: dict[str, list[str]] = {}
    for one in studies("gc", "--dry-run", "--json", *words).document["found"]:
        kinds.setdefault(one["kind"], []).append(one["name"])
    return kinds


def test_nothing_of_a_finished_project_goes(paths: ProjectPaths, studies: Run) -> None:
    assert found(studies) == {}
    answer = studies("gc")
    assert (answer.code, answer.out.strip()) == (0, "Nothing to remove.")


def test_what_nothing_needs_is_shown_and_goes(paths: ProjectPaths, studies: Run) -> None:
    entry, store = the_study(paths)
    best = next(folder.name for folder in Path(store.place).glob("t*") if (folder / "surrogate").is_dir())
    (loser,) = [trial_folder(paths, i) for i in range(3) if trial_folder(paths, i).name != best][:1]
    shutil.copytree(Path(store.place) / best / "surrogate", loser / "surrogate")
    superseded = add_superseded(paths)
    sets = paths.data / "office" / "generated" / "sets"
    shutil.copy(next(sets.glob("test*")), sets / "test-n00032-0123456789ab.npz")
    (paths.artifacts / LABEL / ("0" * 32)).mkdir()
    (paths.mlruns / "reports" / "office-gone").mkdir(parents=True)
    (Path(store.place) / ".gone-t001").mkdir()
    client = tracker_of(paths).client
    deleted = [run for run in read_mlflow(paths).runs if run.role == "calibration"]
    client.delete_run(deleted[0].run_id)
    model = f"{LABEL}-n0016"
    (version,) = client.search_model_versions(f"name = '{model}'")
    client.create_model_version(model, f"{version.source}-older", tags={"champion_sha256": "older"})
    wanted = {
        "superseded studies": [superseded],
        "weights of other trials": [f"{entry.name}: 1"],
        "deleted runs": [f"{LABEL}: n0016 calibration"],
        "superseded models": [f"{model} version 2"],
        "files of no run": [f"mlruns/artifacts/{LABEL}/{'0' * 32}"],
        "sets of rows": ["data/office/generated/sets/test-n00032-0123456789ab.npz"],
        "reports": ["mlruns/reports/office-gone"],
        "scratch": [paths.show(Path(store.place) / ".gone-t001")],
    }
    before = contents(paths.root)
    assert found(studies) == wanted
    assert found(studies, "--older-than", "30d") == {}
    refused = studies("gc")
    assert refused.code == 2
    assert "nobody is here to be asked; give --yes" in refused.err
    assert contents(paths.root) == before
    records = store.records()

    answer = studies("gc", "--yes", "--json")
    assert (answer.code, answer.document["removed"]) == (0, 8)
    assert found(studies) == {}
    assert [one.name for one in list_studies(paths)] == [entry.name]
    assert store.records() == records
    assert not Path(deleted[0].folder or "").exists()
    assert [store for store, _ in bad_findings(studies, "--repair")] == []


def test_a_study_goes_from_everywhere_with_its_case(
    paths: ProjectPaths, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("studies.paths.EMBEDDED", paths.root)  # there the office would still be found
    entry, _ = the_study(paths)
    shutil.rmtree(paths.fmus / "office")
    assert found(studies) == {"studies without case or profile": [entry.name]}
    assert studies("gc", "--yes", "--quiet").code == 0
    assert list_studies(paths) == []
    assert not paths.champion(LABEL, 16).exists()
    content = read_mlflow(paths)
    assert content.versions == ()
    assert [run.role for run in content.active if run.role in ("study", "trial")] == []
    assert found(studies)["deleted runs"] != []
    assert (paths.results(LABEL) / "calibration-n0016.json").is_file()
    assert bad_findings(studies) == []


def test_what_somebody_works_on_stays(paths: ProjectPaths, studies: Run) -> None:
    name = add_superseded(paths)
    claim = Claim(1, {}, {}, 1, "gp", 0.0, 10, owner=this_owner(), token="t")
    open_trials(paths, name).put_claim(claim)
    assert found(studies) == {}


@pytest.mark.parametrize(("answered", "is_gone"), [("y\n", True), ("\n", False), ("no\n", False)])
def test_a_person_is_asked(
    paths: ProjectPaths, studies: Run, monkeypatch: pytest.MonkeyPatch, answered: str, is_gone: bool
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    report = paths.mlruns / "reports" / "office-gone"
    report.mkdir(parents=True)
    monkeypatch.setattr(sys, "stdin", Terminal(answered))
    answer = studies("gc")
    assert answer.code == 0
    assert "Remove it for good? [y/N]" in answer.err
    assert ("Nothing was removed." in answer.out) is not is_gone
    assert report.exists() is not is_gone


def test_simulations_go_only_when_asked_and_only_those_of_no_set(paths: ProjectPaths, studies: Run) -> None:
    sets = [RowSet.load(file) for file in sorted((paths.data / "office" / "generated" / "sets").glob("*"))]
    before = [one.read() for one in sets]
    folder = sets[0].store
    with SimulationStore.at(folder) as store:
        extra = replace(before[0], theta=before[0].theta * 1.0000001)
        store.append(extra)
    assert found(studies) == {}
    (name,) = found(studies, "--simulations")["simulations"]
    n_named = sum(one.n for one in sets)  # the calibration's rows are in no set
    assert name.endswith(f": {96 - n_named + extra.n} of {96 + extra.n} rows")
    assert studies("gc", "--simulations", "--yes", "--quiet").code == 0
    with SimulationStore.at(folder) as store:
        assert len(store.theta) == n_named
    for one, rows in zip(sets, before, strict=True):
        assert np.array_equal(one.read().y, rows.y)
    assert bad_findings(studies) == []


def test_rows_of_a_young_set_are_not_told_as_free(paths: ProjectPaths, studies: Run) -> None:
    sets = paths.data / "office" / "generated" / "sets"
    rows = RowSet.load(next(sets.glob("test*")))
    with SimulationStore.at(rows.store) as store:
        store.append(replace(rows.read(), theta=rows.theta * 1.0000001))
    RowSet(rows.theta * 1.0000001, rows.store, sets / "unnamed.npz").save()
    for part in rows.store.glob("part-*"):
        os.utime(part, (0.0, 0.0))
    (all_of_it,) = found(studies, "--simulations")["simulations"]
    (old,) = found(studies, "--simulations", "--older-than", "1d")["simulations"]
    n_free, n_old = (int(name.rsplit(": ")[1].split()[0]) for name in (all_of_it, old))
    assert n_free - n_old == rows.n


def test_simulations_of_a_running_command_stay(
    paths: ProjectPaths, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = []
    save = RowSet.save

    def clean_first(rows: RowSet) -> None:
        said.append(studies("gc", "--simulations", "--yes"))
        save(rows)

    monkeypatch.setattr(RowSet, "save", clean_first)
    assert studies("simulate", "--profile", "smoke", "--quiet").code == 0
    assert {answer.code for answer in said} == {1}
    assert all("rows: a command works with them now" in answer.err for answer in said)
    assert "npz: a command works with its simulations now" in said[-1].err


def test_simulations_of_a_calibration_stay_until_it_is_stored(
    paths: ProjectPaths, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = []

    def clean_first(file: Path, content: object) -> None:
        said.append(studies("gc", "--simulations", "--yes"))
        write_json(file, content)  # type: ignore[arg-type]

    monkeypatch.setattr("studies.stages.adaptive.write_json", clean_first)
    assert studies("calibrate", "office", "--profile", "smoke", "--max-calls", "28", "--quiet").code == 0
    (answer,) = said
    assert "rows: a command works with them now" in answer.err


def test_rows_of_a_set_that_came_since_stay(
    paths: ProjectPaths, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    sets = paths.data / "office" / "generated" / "sets"
    rows = RowSet.load(next(sets.glob("test*")))
    free = rows.theta * 1.0000001

    def simulated_meanwhile(*_: object) -> bool:
        RowSet(free, rows.store, sets / "new.npz").save()
        return True

    with SimulationStore.at(rows.store) as store:
        store.append(replace(rows.read(), theta=free))
        monkeypatch.setattr("studies.keeping.collection.is_agreed", simulated_meanwhile)
        assert studies("gc", "--simulations").code == 0
        assert store.find(free).all()


def test_an_age_that_is_none_is_refused(paths: ProjectPaths, studies: Run) -> None:
    answer = studies("gc", "--older-than", "soon")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "--older-than 'soon' is no age; write for example 30d" in answer.err
