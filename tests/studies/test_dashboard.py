"""`studies dashboard`: Optuna Dashboard on the studies of a project, until Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest
from tuning_checks import ignore

from studies.paths import ProjectPaths
from studies.tuning.study_spec import StudySpec
from studies.tuning.study_store import StudyStore
from studies.tuning.trial_store import open_trials
from studies.tuning.trial_worker import run_study

LIMIT_S = 60.0


def test_it_starts_shows_the_studies_and_ends_with_ctrl_c(
    make_spec: Callable[..., StudySpec], tmp_path: Path
) -> None:
    pytest.importorskip("optuna_dashboard", reason="Optuna Dashboard is not installed")
    spec = make_spec()
    (tmp_path / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    paths = ProjectPaths(tmp_path)
    run_study(spec, paths=paths, n_trials=2, emit=ignore)
    store = StudyStore(spec, paths)
    store.tell(open_trials(paths, spec.name))
    store.close()
    server = subprocess.Popen(
        [sys.executable, "-m", "studies", "dashboard", "--json"],
        env=os.environ | {"STUDIES_ROOT": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert server.stdout is not None
        said = ""
        while not said.endswith("}\n") and (line := server.stdout.readline()):
            said += line
        page = json.loads(said)["url"]
        with urllib.request.urlopen(page, timeout=LIMIT_S) as answer:
            assert b"Optuna Dashboard" in answer.read()
        with urllib.request.urlopen(page.replace("/dashboard/", "/api/studies"), timeout=LIMIT_S) as answer:
            (shown,) = json.load(answer)["study_summaries"]
        assert shown["study_name"] == spec.name
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=LIMIT_S)
    finally:
        server.kill()
        server.wait()
    assert server.returncode == 0, errors
    assert "dashboard: stopped" in errors
