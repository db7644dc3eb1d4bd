"""Where memory is limited, as on clusters, a picture may be missing; the result never is."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mlflow_store_for_tests import give_store
from project_for_tests import REPOSITORY


@pytest.mark.slow
def test_a_picture_that_cannot_be_drawn_costs_a_line_and_no_result(tmp_path: Path) -> None:
    give_store(tmp_path)
    command = 'ulimit -v 48000000; exec "$0" -P -m studies calibrate wall --max-calls 12 --jobs 1 --json'
    done = subprocess.run(
        ["bash", "-c", command, sys.executable],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["stages"][0]["mse"] < 1.0
    missing = [line for line in done.stderr.splitlines() if "cannot be drawn" in line]
    assert all("ulimit -v unlimited" in line for line in missing)
    assert len(missing) == 2, done.stderr
