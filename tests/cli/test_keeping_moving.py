"""`studies export` and `studies import`: a study elsewhere is the same study."""

import io
import json
import shutil
import subprocess
import sys
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kept_project import LABEL, bad_findings, contents, copy_project, enter, flip, the_study, trial_folder
from project_for_tests import TINY_PROFILE, Run, make_project

from studies.keeping.stage_views import write_stages
from studies.paths import ProjectPaths

CALIBRATE = ("calibrate", "--method", "paper", "--profile", "tiny.toml", "--quiet")


@pytest.fixture
def paths(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    return copy_project(finished, tmp_path / "project", monkeypatch)


@pytest.fixture
def archive(paths: ProjectPaths, studies: Run) -> Path:
    file = paths.root / "study.tar.gz"
    assert studies("export", LABEL, "--to", str(file), "--with-simulations").code == 0
    return file


def clean_project(root: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    """Make a project as a clone is: a case, a recording and a profile."""
    make_project(root)
    (root / "tiny.toml").write_text(TINY_PROFILE, encoding="utf-8")
    paths = ProjectPaths(root)
    enter(paths, monkeypatch)
    return paths


def numbers_of(paths: ProjectPaths) -> dict:  # type: ignore[type-arg]
    content = json.loads((paths.results(LABEL) / "calibration-n0016.json").read_text())
    return {name: value for name, value in content.items() if name not in ("recipe", "environment")}


def test_a_study_is_the_same_in_another_project(
    paths: ProjectPaths, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    file = tmp_path / "study.tar.gz"
    packed = studies("export", LABEL, "--to", str(file), "--json").document
    assert (packed["n_trials"], packed["n_rows"]) == (3, 0)
    entry, store = the_study(paths)
    other = clean_project(tmp_path / "other", monkeypatch)
    first = studies("import", str(file), "--json")
    assert first.code == 0
    assert first.document["new"] == {entry.name: 3}
    there, kept = the_study(other)
    assert there == entry
    assert kept.records() == store.records()
    assert contents(other.champion(LABEL, 16)) == contents(paths.champion(LABEL, 16))
    assert bad_findings(studies) == []  # Optuna and MLflow tell the same
    # The numbers, not the stored result: it is calibrated again, on simulations that are done again.
    wanted = numbers_of(paths)
    for name in ("calibrate-n0016.json", "calibration-n0016.json", "calibration-n0016.npz"):
        (other.results(LABEL) / name).unlink()
    assert studies(*CALIBRATE).code == 0
    assert numbers_of(other) == wanted
    again = studies("import", str(file), "--json").document
    assert (again["new"], again["known"]) == ({entry.name: 0}, {entry.name: 3})
    assert numbers_of(other) == wanted


def test_a_stage_is_finished_elsewhere_with_all_its_files_or_not_at_all(
    paths: ProjectPaths, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    made_up = {
        "sensitivity": ["sensitivity"],
        "uncertainty-n0016": ["posterior-n0016", "posterior-n0016-rows"],
    }
    for stage, stems in made_up.items():
        files = [paths.results(LABEL) / f"{stem}.npz" for stem in stems]
        for file in files:
            np.savez(file, numbers=np.arange(3))
        if stage != "sensitivity":
            files.append(paths.results(LABEL) / "posterior-n0016.json")
            files[-1].write_text("{}")
        sizes = {paths.relative(file): file.stat().st_size for file in files}
        told = {"stage": stage, "digest": stage, "summary": {}, "files": sizes, "wall_s": 1.0}
        told |= {"finished": "2026-01-01T00:00:00+00:00", "recipe": {}, "environment": {}}
        (paths.results(LABEL) / f"{stage}.json").write_text(json.dumps(told))
    file = tmp_path / "study.tar.gz"
    packed = "1 study, 3 trials, 1 champion, 1 calibration, 1 uncertainty, 3 other stages"
    assert f"{packed}; " in studies("export", LABEL, "--to", str(file)).out
    other = clean_project(tmp_path / "other", monkeypatch)

    def killed(source: Path, place: Path) -> None:
        if source.name == "sensitivity.npz":
            raise KeyboardInterrupt
        shutil.copyfile(source, place)

    with monkeypatch.context() as patch:
        patch.setattr("studies.keeping.importing.shutil.copy2", killed)
        assert studies("import", str(file)).code == 130
    # What came before it was killed is here already.
    assert "new here: 1 uncertainty, 3 other stages\n" in studies("import", str(file)).out
    assert contents(other.results(LABEL)) == contents(paths.results(LABEL))


def test_a_study_goes_to_a_server_and_back(
    archive: Path,
    paths: ProjectPaths,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    storage: str,
) -> None:
    entry, store = the_study(paths)
    server = clean_project(tmp_path / "server", monkeypatch)
    monkeypatch.setenv("STUDIES_STORAGE", storage)
    imported = json.loads(apart("import", str(archive), "--json"))
    assert imported["n_rows"] == 80
    on_server = ProjectPaths(server.root, storage)
    there, kept = the_study(on_server)
    assert there.created_s == pytest.approx(entry.created_s, abs=1e-3)  # the server counts microseconds
    assert replace(there, created_s=entry.created_s) == entry
    assert kept.records() == store.records()
    assert not (server.mlruns / "trials").exists()
    assert json.loads(apart("doctor", "--json"))["sound"]
    back = tmp_path / "back.tar.gz"
    apart("export", LABEL, "--to", str(back), "--with-simulations")
    with tarfile.open(back) as theirs, tarfile.open(archive) as ours:
        manifests = [json.load(one.extractfile("archive.json") or io.BytesIO()) for one in (ours, theirs)]
    sets = [{name: one for name, one in m["files"].items() if "simulations" not in name} for m in manifests]
    assert set(sets[0]) == set(sets[1])
    trials = [
        {n: one for n, one in s.items() if n.endswith(("trial.json", ".npz", "champion.json"))} for s in sets
    ]
    assert trials[0] == trials[1]


def apart(*words: str) -> str:
    """Run a command in a process of its own, which hangs up on the server when it ends."""
    command = [sys.executable, "-m", "studies", *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_what_is_missing_of_a_study_is_added(archive: Path, paths: ProjectPaths, studies: Run) -> None:
    entry, store = the_study(paths)
    before = store.records()
    shutil.rmtree(trial_folder(paths, 2))
    done = studies("import", str(archive), "--json").document
    assert (done["new"], done["known"]) == ({entry.name: 1}, {entry.name: 2})
    assert store.records() == before
    assert bad_findings(studies) == []


def test_stages_of_a_case_that_is_not_here_are_told_of_in_one_line(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    other = clean_project(tmp_path / "other", monkeypatch)
    shutil.rmtree(other.root / "fmus")
    assert studies("import", str(archive)).code == 0
    for file in sorted(other.results(LABEL).glob("calibrat*-n0016.json")):
        shutil.copy(file, file.with_name(file.name.replace("16", "32")))
    (line,) = write_stages(other, LABEL)
    names = f"{LABEL}/calibrate-n0016 and {LABEL}/calibrate-n0032"
    assert line.startswith(f"{names} are not shown in MLflow: ")
    assert line.endswith("case.toml: no such file; a case is a folder with a case.toml")


def test_a_trial_that_says_something_else_stops_the_import(
    archive: Path, paths: ProjectPaths, studies: Run
) -> None:
    file = trial_folder(paths, 1) / "trial.json"
    file.write_text(file.read_text().replace('"seed": ', '"seed": 9'))
    shutil.rmtree(trial_folder(paths, 2))
    before = contents(paths.mlruns)
    answer = studies("import", str(archive))
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert "/t001 is here with other results than in " in answer.err
    assert "(seed)" in answer.err
    assert contents(paths.mlruns) == before


def test_archives_that_cannot_be_trusted_are_refused_in_one_line(
    archive: Path, paths: ProjectPaths, tmp_path: Path, studies: Run
) -> None:
    damaged, cut, newer, evil, other, ordinary = (tmp_path / f"{name}.tar.gz" for name in "abcdef")
    shutil.copy(archive, damaged)
    flip(damaged)
    cut.write_bytes(archive.read_bytes()[:-2000])
    write_tar(newer, {"archive.json": b'{"format": 99, "files": {}}'})
    write_tar(evil, {"../../evil.txt": b"x", "archive.json": b'{"format": 1, "files": {}}'})
    write_tar(other, {"archive.json": b'{"format": 1, "files": {"mlruns/x": {"sha256": "", "size": 0}}}'})
    with tarfile.open(ordinary, "w:gz") as made:
        made.add(paths.fmus, ".")
    before = contents(paths.mlruns)
    for file, said in (
        (damaged, "copy"),  # the checksum's word or that of the compression, as the byte happens to lie
        (cut, "damaged or no archive of studies"),
        (newer, "is of format 99, this version reads 1"),
        (evil, "holds '../../evil.txt', which is none of ours; nothing was imported"),
        (other, "mlruns/x is missing"),
        (ordinary, "holds '.', which is none of ours; nothing was imported"),
        (tmp_path / "nothing.tar.gz", "there is no file"),
        (tmp_path, "is a folder; give an archive"),
    ):
        answer = studies("import", str(file))
        assert answer.code == 2
        assert answer.err.count("\n") == 1
        assert said in answer.err
    assert contents(paths.mlruns) == before
    assert not (paths.root.parent.parent / "evil.txt").exists()


def write_tar(file: Path, members: dict[str, bytes]) -> None:
    with tarfile.open(file, "w:gz") as archive:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))


def test_an_export_names_what_there_is_and_overwrites_nothing(paths: ProjectPaths, studies: Run) -> None:
    answer = studies("export", "ofice", "--to", "a.tar.gz")
    assert answer.code == 2
    assert "nothing is called 'ofice'; there are office-tiny" in answer.err
    (paths.root / "a.tar.gz").write_text("mine")
    assert (
        "a.tar.gz exists; remove it or name another file" in studies("export", LABEL, "--to", "a.tar.gz").err
    )
    assert (paths.root / "a.tar.gz").read_text() == "mine"
