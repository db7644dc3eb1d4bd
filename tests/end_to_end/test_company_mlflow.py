"""The page "From the company's MLflow": each of its commands, with a server of the test's own."""

import os
import re
import subprocess
import sys
from pathlib import Path

import mlflow
import pytest
from mlflow_server_for_tests import MlflowServer
from mlflow_store_for_tests import give_store

from studies.cli import main
from studies.tracking.quiet_mlflow import connect

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "company-mlflow.md"


def blocks(kind: str, uri: str) -> list[str]:
    """Return the page's blocks of a language, with the address of a real server."""
    text = PAGE.read_text("utf-8").replace("https://mlflow.example.com", uri)
    return re.findall(rf"^```{kind}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def test_a_finished_command_sends_what_it_could_not_send_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "project"
    give_store(root)
    (root / "studies.toml").touch()
    monkeypatch.chdir(root)
    server = MlflowServer(tmp_path / "server")
    words = ("tune", "wall", "--profile", "smoke", "--n-train", "16", "--jobs", "1", "--tracking", server.uri)
    try:
        server.kill()
        assert main(words) == 0
        assert "sent by the next command" in capsys.readouterr().err
        server.start()
        assert main(words) == 0
        said = capsys.readouterr().err
        assert "tune: finished before" in said
        assert "not on" not in said
        here, there = (
            {run.info.run_name: (run.info.status, run.data.metrics) for run in client.search_runs(["1"])}
            for client in (connect(f"sqlite:///{root}/mlruns/mlflow.db"), mlflow.MlflowClient(server.uri))
        )
        assert there == here
        assert len(here) >= 5
    finally:
        server.close()


def test_every_command_of_the_page_does_what_it_says(tmp_path: Path) -> None:
    root, home = tmp_path / "project", tmp_path / "home"
    give_store(root)
    home.mkdir()
    (root / "studies.toml").touch()
    server = MlflowServer(tmp_path / "server")
    environment = {name: one for name, one in os.environ.items() if not name.startswith(("MLFLOW", "XDG"))}
    environment |= {"HOME": str(home), "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"

    def run(script: str, shell: tuple[str, ...] = ("bash", "-ec")) -> str:
        done = subprocess.run(
            [*shell, script], cwd=root, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return f"{done.stdout}\n{done.stderr}"

    try:
        by_variable, by_file = blocks("sh", server.uri)
        said = run(by_variable)
        assert f"All runs of wall-quick: {server.uri}/#/experiments/1/" in said
        assert "not on" not in said
        marker = (root / "studies.toml").read_text("utf-8")
        assert re.fullmatch(r'project = "[0-9a-f]{32}"\n', marker)
        *_, command = by_file.strip().splitlines()
        refused = subprocess.run(
            ["bash", "-c", by_file.splitlines()[0] + "\n" + command],
            cwd=root,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert refused.returncode == 2
        assert "which you have not allowed" in refused.stderr
        (root / "studies.toml").write_text(marker, "utf-8")
        assert "wall-quick/adaptive" in run(by_file)
        (example,) = blocks("python", server.uri)
        listed = run(example, (sys.executable, "-c"))
        assert listed.count("adaptive calibration") == 1
        client = mlflow.MlflowClient(server.uri)
        names = {one.name for one in client.search_experiments()}
        assert names == {"Default", "wall-quick"}
    finally:
        server.close()
