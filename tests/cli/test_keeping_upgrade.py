"""`studies doctor --upgrade`: databases and descriptions of earlier versions are brought up to date."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from kept_project import bad_findings, copy_project, the_study
from project_for_tests import Run
from sqlalchemy import create_engine

from studies.keeping.versions import migrations_of
from studies.paths import ProjectPaths
from studies.tuning.trial_store import list_studies

EARLIER = "bf29a5ff90ea"
"""A revision of MLflow's database from before evaluation datasets, budgets and reviews."""


@pytest.fixture
def paths(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    return copy_project(finished, tmp_path / "project", monkeypatch)


def make_earlier_database(paths: ProjectPaths) -> None:
    """Make MLflow's database as an earlier MLflow made it: by its migrations, up to a revision."""
    from mlflow.store.tracking.dbmodels.initial_models import Base

    paths.tracking_database.unlink()
    engine = create_engine(paths.tracking_uri)
    Base.metadata.create_all(engine)
    with engine.begin() as connection:
        config = migrations_of("MLflow")
        config.attributes["connection"] = connection
        command.upgrade(config, EARLIER)
    engine.dispose()


def revision(database: Path) -> str:
    with closing(sqlite3.connect(database)) as connection:
        ((found,),) = connection.execute("select version_num from alembic_version")
    return str(found)


def test_an_earlier_database_of_mlflow_is_told_copied_and_upgraded(paths: ProjectPaths, studies: Run) -> None:
    make_earlier_database(paths)
    (finding,) = bad_findings(studies)
    assert finding[0] == "versions"
    assert finding[1].startswith(f"is of version {EARLIER}, MLflow 3.")
    refused = studies("tune", "--profile", "tiny.toml", "--trials", "4", "--quiet")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert f"mlruns/mlflow.db is of version {EARLIER}, MLflow 3." in refused.err
    assert refused.err.endswith("; type: studies doctor --upgrade (it keeps a copy)\n")
    assert revision(paths.tracking_database) == EARLIER
    answer = studies("doctor", "--upgrade", "--repair", "--json")
    assert answer.code == 0
    assert answer.document["done"][0].startswith(f"mlruns/mlflow.db from {EARLIER} to ")
    (copy,) = (paths.mlruns / "copies").iterdir()
    assert revision(copy) == EARLIER
    assert bad_findings(studies) == []  # --repair wrote all runs into it


def test_a_later_database_is_not_touched(paths: ProjectPaths, studies: Run) -> None:
    with closing(sqlite3.connect(paths.tracking_database)) as database, database:
        database.execute("update alembic_version set version_num = 'fedcba987654'")
    (finding,) = bad_findings(studies)
    assert finding[1].startswith("was written by a newer version (fedcba987654;")
    answer = studies("doctor", "--upgrade")
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert "install a newer mlflow, nothing was changed" in answer.err
    assert revision(paths.tracking_database) == "fedcba987654"


def test_studies_without_a_description_get_one(paths: ProjectPaths, studies: Run) -> None:
    entry, store = the_study(paths)
    (Path(store.place) / "study.json").unlink()
    assert list_studies(paths) == []
    assert ("versions", "1 study of an earlier version, without a description") in bad_findings(studies)
    assert studies("doctor", "--upgrade").code == 0
    (again,) = list_studies(paths)
    told = ("name", "label", "case_name", "n_train", "n_planned", "variant", "output_unit", "digests", "note")
    assert {name: getattr(again, name) for name in told} == {name: getattr(entry, name) for name in told}
    (paths.mlruns / "optuna.journal").unlink()
    assert bad_findings(studies, "--repair") == []  # also without a recipe
