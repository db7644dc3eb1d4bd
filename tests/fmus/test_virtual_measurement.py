"""The virtual measurement of the office: that it is plausible, and can be made again."""

import subprocess
import sys

import pytest
from fmu_for_tests import REPOSITORY

FOLDER = REPOSITORY / "data" / "office"


def test_files_are_made_again_byte_for_byte(tmp_path):
    pytest.importorskip("pvlib", reason="pip install -e '.[modelica]'")
    command = [sys.executable, FOLDER / "generate.py", "--to", tmp_path]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    for name in ("recording_1800s.csv", "occupancy_600s.csv"):
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name
