"""The virtual measurement of the office: that it is plausible, and can be made again."""

import subprocess
import sys

import numpy as np
import pytest
from fmu_for_tests import REPOSITORY

from simulation.case import load_case

FOLDER = REPOSITORY / "data" / "office"

# The best of 20 least-squares starts on days 0 to 10, found with an independent matrix-exponential solution.
# In the order of the case file.
BEST = np.array(
    [
        1.34311,
        297.016,
        0.11375,
        144023,
        2.86673,
        3.84935,
        0.137161,
        42499.6,
        625508,
        0.190004,
        0.0627164,
        0.0210428,
        0.244176,
        20.7769,
    ]
)
BEST_MSE = 0.01052


def test_files_are_made_again_byte_for_byte(tmp_path):
    pytest.importorskip("pvlib", reason="pip install -e '.[modelica]'")
    command = [sys.executable, FOLDER / "generate.py", "--to", tmp_path]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    for name in ("recording_1800s.csv", "occupancy_600s.csv"):
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes(), name


def test_grey_box_fits_as_well_as_found_by_hand_and_not_perfectly():
    case = load_case(REPOSITORY / "fmus" / "office" / "case.toml")
    assert case.window_d == (0, 10)
    with case.open_model() as model:
        answer = model.simulate(BEST[None])
    mse = float(np.mean((answer.y[0] - case.measurement.y) ** 2))
    assert mse == pytest.approx(BEST_MSE, rel=5e-3)
