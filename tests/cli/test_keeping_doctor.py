"""`studies doctor`: whatever is damaged is found and named, and what is safe is put right."""

import json
import shutil
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import pytest
from kept_project import LABEL, bad_findings, contents, copy_project, enter, flip, the_study, trial_folder
from project_for_tests import Run

from studies.keeping.optuna_view import read_optuna
from studies.paths import ProjectPaths
from studies.tuning.claim import Claim, this_owner
from studies.tuning.trial_record import best_record


@pytest.fixture
def paths(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    return copy_project(finished, tmp_path / "project", monkeypatch)


def sql(paths: ProjectPaths, *statements: str) -> None:
    with closing(sqlite3.connect(paths.tracking_database)) as database, database:
        for statement in statements:
            database.execute(statement)


def claim_of(owner: dict, index: int = 7) -> Claim:  # type: ignore[type-arg]
    return Claim(index, {}, {}, 1, "gp", time.time() - 60, 10, owner=owner, token="t")


def test_a_sound_project_is_said_to_be_sound_and_left_alone(paths: ProjectPaths, studies: Run) -> None:
    before = contents(paths.root)
    answer = studies("doctor")
    assert answer.code == 0
    assert "The stores are sound." in answer.out
    assert "bad" not in answer.out
    for line in ("1 study, 3 trials, all readable", "3 trials as the records say", "96 rows in 1 folder"):
        assert line in " ".join(answer.out.split())
    assert contents(paths.root) == before


def test_damage_everywhere_is_found_and_put_right_without_losing_a_record(
    paths: ProjectPaths, studies: Run
) -> None:
    entry, store = the_study(paths)
    records = store.records()
    best = best_record(records)
    assert best is not None
    lost, other = [record.index for record in records if record.index != best.index]
    curves = trial_folder(paths, other) / "history.npz"
    curves.write_bytes(curves.read_bytes()[:100])
    (trial_folder(paths, lost) / "trial.json").write_text('{"study": ')
    shutil.rmtree(trial_folder(paths, best.index) / "surrogate")
    store.put_claim(claim_of({**this_owner(), "pid": 2**22 - 3}))
    (part, *_) = (paths.data / "office" / "generated" / "simulations").glob("*/part-*")
    flip(part)
    journal = paths.mlruns / "optuna.journal"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:-1]))
    sql(
        paths,
        f"update runs set status = 'RUNNING' where name = 'n0016 trial {other:03d}'",
        "update tags set value = '{}' where key = 'owner'",
        "update runs set start_time = start_time - 10000000",
        "update latest_metrics set value = 9 where key = 'val/mae'",
        "delete from registered_model_aliases",
    )
    for folder in (paths.artifacts / LABEL).glob("*/artifacts/figures"):
        shutil.rmtree(folder)
    (trial_folder(paths, 0).parent / ".t009-4194301").mkdir()
    found = bad_findings(studies)
    said = sorted(f"{store}: {what}" for store, what in found)
    for start in (
        "records: its record cannot be read (JSONDecodeError",
        "records: its learning curves cannot be read",
        "records: the weights of the best trial are missing",
        "records: t007: running, though the process is no more",
        "Optuna: ",
        "MLflow: running, though nobody works on it any more",
        f"MLflow: t{best.index:03d}, t{other:03d} tell other ends or errors; t{lost:03d} has no record"
        if best.index < other
        else f"MLflow: t{other:03d}, t{best.index:03d} tell other ends or errors; t{lost:03d} has no record",
        "MLflow: figures or numbers are gone",
        "MLflow: the champion is not registered",
        "simulations: 1 part damaged",
        "scratch: 1 leftover of killed processes",
    ):
        assert any(line.startswith(start) for line in said), (start, said)
    assert len(found) == 11

    assert bad_findings(studies, "--repair") == []
    assert {record.index for record in the_study(paths)[1].records()} == {best.index, other}
    assert store.record(best.index) == best
    assert {trial.index for trial in read_optuna(paths)[entry.name]} == {best.index, other}
    aside = trial_folder(paths, 0).parent / ".damaged" / f"t{lost:03d}"
    assert (aside / "trial.json").read_text() == '{"study": '
    assert [claim.is_owned for claim, _ in store.claims()] == [False]


def test_a_champion_keeps_what_is_good_of_it(paths: ProjectPaths, studies: Run) -> None:
    folder = paths.champion(LABEL, 16)
    before = contents(folder)
    flip(folder / "weights.npz")
    ((_, found),) = [one for one in bad_findings(studies) if one[0] == "champions"]
    assert "weights.npz is damaged (sha256 differs)" in found
    assert bad_findings(studies, "--repair") == []
    assert contents(folder) == before


def test_views_that_are_gone_are_written_again(paths: ProjectPaths, studies: Run) -> None:
    (paths.mlruns / "optuna.journal").write_text("no journal\n")
    sql(
        paths,
        "delete from registered_model_aliases",
        "update runs set lifecycle_stage = 'deleted' where name like 'n0016%'",
    )
    stores = [store for store, _ in bad_findings(studies)]
    assert stores.count("Optuna") == 1
    assert stores.count("MLflow") == 3  # study, calibration, champion
    assert bad_findings(studies, "--repair") == []


def test_a_stage_that_was_done_again_while_mlflow_was_away_is_told_of(
    paths: ProjectPaths, studies: Run
) -> None:
    sql(paths, "update latest_metrics set value = 2 * value where key = 'mse/polished'")
    assert bad_findings(studies) == [("MLflow", "calibrate-n0016 has no run of these results")]
    assert bad_findings(studies, "--repair") == []


def test_a_moved_project_finds_its_files_again(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    root = tmp_path / "elsewhere"
    shutil.copytree(finished, root)
    monkeypatch.setenv("STUDIES_ROOT", str(root))
    assert bad_findings(studies) == [
        ("MLflow", "MLflow looks for files there, the project has moved since"),
    ]
    assert bad_findings(studies, "--repair") == []
    with closing(sqlite3.connect(root / "mlruns" / "mlflow.db")) as database:
        places = database.execute("select artifact_uri from runs union select source from model_versions")
        assert all(place.startswith((root / "mlruns").as_uri()) for (place,) in places)


def test_what_somebody_works_on_is_told_and_left_alone(paths: ProjectPaths, studies: Run) -> None:
    _, store = the_study(paths)
    store.put_claim(claim_of(this_owner()))
    (paths.mlruns / "optuna.journal").unlink()
    (paths.mlruns / "optuna.journal").touch()
    answer = studies("doctor", "--repair", "--json")
    (note,) = [
        one for one in answer.document["findings"] if one["store"] == "Optuna" and one["level"] != "ok"
    ]
    assert (note["level"], note["found"]) == ("note", "it is not there; it is being tuned at the moment")
    assert answer.code == 0
    assert read_optuna(paths) == {}


def test_results_that_are_damaged_name_the_command_that_makes_them(paths: ProjectPaths, studies: Run) -> None:
    numbers = paths.results(LABEL) / "calibration-n0016.npz"
    numbers.write_bytes(b"no archive")
    where = {one["where"]: one["remedy"] for one in studies("doctor", "--json").document["findings"]}
    assert "type studies calibrate again" in where[f"{LABEL}/calibrate-n0016"]
    (remaining,) = bad_findings(studies, "--repair")
    assert remaining[1].startswith("1 file of it missing or changed")
    aside = numbers.parent / ".damaged" / numbers.name
    assert aside.read_bytes() == b"no archive"


def test_an_empty_project_is_sound(new_project: Path, studies: Run) -> None:
    answer = studies("doctor", "--json")
    assert answer.code == 0
    assert json.loads(answer.out)["sound"] is True
    assert not (new_project / "mlruns" / "mlflow.db").exists()


def test_a_removed_mlflow_database_is_written_again_by_the_same_command(
    paths: ProjectPaths, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    for command in ("sensitivity", "report"):
        assert studies(command, "--profile", "tiny.toml").code == 0
    before = told(paths)
    roles = {"study", "trial", "overview", "calibration", "sensitivity", "report"}
    assert {what for what, *_ in before} == roles | {f"{LABEL}-n0016"}
    # Another place: MLflow remembers the databases that a process has opened.
    again = ProjectPaths(tmp_path / "again")
    shutil.copytree(paths.root, again.root, ignore=shutil.ignore_patterns("mlflow.db*"))
    enter(again, monkeypatch)
    answer = studies("calibrate", "--profile", "tiny.toml", "--method", "paper")
    assert "is gone: writing it again from the records" in answer.err
    assert "calibrate-n0016: finished before" in answer.err
    assert told(again) == before
    assert bad_findings(studies) == []
    assert "is gone" not in studies("calibrate", "--profile", "tiny.toml", "--method", "paper").err


def told(paths: ProjectPaths) -> list[tuple[str, ...]]:
    """Return what MLflow tells: every run with its numbers, and which models bear which alias."""
    with closing(sqlite3.connect(paths.tracking_database)) as database:
        numbers = database.execute(
            "select t.value, r.name, r.status, m.key, m.value from runs r"
            " join tags t on t.run_uuid = r.run_uuid and t.key = 'role'"
            " left join latest_metrics m on m.run_uuid = r.run_uuid order by 1, 2, 4"
        ).fetchall()
        return numbers + database.execute("select name, alias from registered_model_aliases").fetchall()
