"""The commands and the Python of the page run one after the other, on a small study."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mlflow_store_for_tests import give_store

from studies import api
from studies.cli import main
from studies.paths import find_project
from studies.project import read_project
from studies.tracking.registry import load_surrogate
from studies.tracking.runs import run_store

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "values.md"
TINY = """\
name = "tiny"
[data]
n_train = [16]
n_validation = 16
n_test = 16
[tuning]
n_trials = 2
max_epochs = 10
"""
SAME = 1e-6  # relative to the largest value, as the page says


def test_the_page_runs_and_its_answers_are_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxruntime", reason="pip install -e '.[onnx]'")
    monkeypatch.chdir(tmp_path)
    give_store(tmp_path)
    (tmp_path / "tiny.toml").write_text(TINY, encoding="utf-8")
    assert main(["calibrate", "office", "--max-calls", "10", "--jobs", "2", "-q"]) == 0
    assert main(["tune", "office", "--profile", "tiny.toml", "--jobs", "2", "-q"]) == 0
    names: dict[str, Any] = {}
    for kind, block in re.findall(
        r"^```(\w+)\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL
    ):
        if kind == "python":
            exec(block, names)
        else:
            assert [main(line.split()[1:]) for line in block.splitlines()] == [0] * block.count("\n")
    project = read_project(find_project(None))
    (study,) = (one for one in project.studies if not one.spec.is_baseline)
    assert study.best is not None
    case = api.load_case("office")
    assert [name for name, _ in json.loads(names["about"]["parameters"])] == list(case.parameter_space.names)
    np.testing.assert_array_equal(json.loads(names["about"]["time_s"]), case.measurement.time)
    expected = load_surrogate(run_store(project.paths), study.best.run_id).predict(names["theta"])
    assert (np.abs(names["y"] - expected) <= SAME * np.abs(expected).max()).all()
    assert names["result"]["TAir"][0] == names["values"]["TAirInit"]
