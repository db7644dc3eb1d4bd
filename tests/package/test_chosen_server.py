"""Which MLflow server runs are sent to: option, environment at the process's start, the project's file."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from simulation.errors import InputError
from studies.paths import ProjectPaths, find_project, mark_project
from studies.server import ALLOWED, Server, choose_server, give_identity, read_server
from studies.words.console import Console

ASK = """
import json, os, sys
os.environ["MLFLOW_TRACKING_URI"] = "http://set.later"  # as mlflow.set_tracking_uri does
from studies.paths import find_project
found = find_project(None, *sys.argv[1:]).server
print(json.dumps(None if found is None else [found.uri, found.registry, found.experiment]))
"""


def asked(root: Path, *words: str, **environment: str) -> object:
    """Return what a process that is started with an environment chooses."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("MLFLOW_")} | environment
    code = [sys.executable, "-c", ASK, *words]
    done = subprocess.run(code, cwd=root, env=env, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_variables_count_as_the_process_was_started_with_them(tmp_path: Path) -> None:
    (tmp_path / "studies.toml").write_text("", encoding="utf-8")
    assert asked(tmp_path) is None
    named = {"MLFLOW_TRACKING_URI": "https://host/mlflow/", "MLFLOW_EXPERIMENT_NAME": "halls/"}
    assert asked(tmp_path, **named) == ["https://host/mlflow", "https://host/mlflow", "halls/"]
    assert asked(tmp_path, "http://other:5000", **named) == ["http://other:5000"] * 2 + ["halls/"]
    assert asked(tmp_path, "local", **named) is None
    both = {"MLFLOW_TRACKING_URI": "databricks", "MLFLOW_REGISTRY_URI": "databricks://profile"}
    assert asked(tmp_path, **both) == ["databricks", "databricks://profile", ""]
    # The project's own store is no server beside it.
    assert asked(tmp_path, "sqlite:///mlruns/mlflow.db") is None
    assert asked(tmp_path, "sqlite:///other.db") == [f"sqlite:///{tmp_path}/other.db"] * 2 + [""]


def test_the_file_of_a_project_sends_nothing_unless_its_user_allows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    file, allowed = tmp_path / "studies.toml", tmp_path / "settings" / ALLOWED
    file.write_text('tracking = "https://host"\nexperiment = "x"\n[tags]\nteam = "halls"\n', encoding="utf-8")
    with pytest.raises(
        InputError, match=r"studies.toml sends runs to https://host.*allow it with: .*echo"
    ) as not_yet:
        choose_server(None, file, "")
    assert choose_server("local", file, "") is None
    assert choose_server("http://mine", file, "") == Server(
        "http://mine", "http://mine", "x", (("team", "halls"),)
    )
    command = str(not_yet.value).partition("allow it with: ")[2].partition(", or keep")[0]
    subprocess.run(command, shell=True, check=True)
    assert allowed.read_text() == "https://host\n"
    assert choose_server(None, file, "") == Server("https://host", "https://host", "x", (("team", "halls"),))
    # A registry of its own has to be allowed, too.
    file.write_text('tracking = "https://host"\nregistry = "https://registry"\n', encoding="utf-8")
    with pytest.raises(InputError, match="https://registry"):
        choose_server(None, file, "")


@pytest.mark.parametrize("given", ["https://me:word@host", "https://host?token=word", "http://word@host"])
def test_an_address_with_a_password_is_refused_and_not_shown(given: str) -> None:
    with pytest.raises(InputError, match="MLFLOW_TRACKING_PASSWORD") as refused:
        read_server(given, "$MLFLOW_TRACKING_URI")
    assert "word@" not in str(refused.value)
    assert "=word" not in str(refused.value)


@pytest.mark.parametrize(
    "given", ["mlruns", "file:///tmp/x", "http://", "https://h$(id)", "ftp://host", "http://a b"]
)
def test_what_is_no_server_is_refused_with_the_remedy(given: str) -> None:
    with pytest.raises(InputError, match=r"tracking is .*--tracking local"):
        read_server(given, "studies.toml: tracking")


def test_values_of_the_file_are_texts(tmp_path: Path) -> None:
    (tmp_path / "studies.toml").write_text("[tags]\nteam = 3\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"studies.toml: tags.team is 3; write a text"):
        choose_server(None, tmp_path / "studies.toml", "")


def test_a_project_that_shares_a_server_has_an_identity_that_copies_keep(tmp_path: Path) -> None:
    server = Server("http://host", "http://host")
    file = tmp_path / "studies.toml"
    file.write_text("# mine\n[tags]\nteam = 'halls'\n", encoding="utf-8")
    alone, sharing = ProjectPaths(tmp_path), ProjectPaths(tmp_path, None, server)
    mark_project(alone, Console(quiet=True))
    assert alone.identity == sharing.identity == ""
    mark_project(sharing, Console(quiet=True))
    mark_project(sharing, Console(quiet=True))
    text = file.read_text(encoding="utf-8")
    assert len(sharing.identity) == 32
    assert text == f"project = \"{sharing.identity}\"\n# mine\n[tags]\nteam = 'halls'\n"
    assert alone.identity == ""  # where nothing is shared it decides nothing
    give_identity(file)
    assert file.read_text(encoding="utf-8") == text
    assert find_project(None, "local").server is None
