"""The virtual measurement of the office: that it is plausible, and can be made again."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from fmu_for_tests import REPOSITORY

from simulation.case import load_case

FOLDER = REPOSITORY / "data" / "office"
RECORDING = pd.read_csv(FOLDER / "recording_1800s.csv")
DAY = RECORDING["time_s"] / 86400
HOUR = 24 * (DAY % 1)

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


def test_sun_stays_below_what_arrives_outside_the_atmosphere():
    """Independent of pvlib: declination and hour angle by hand (Cooper's formula)."""
    day_of_year = 52 + DAY
    declination = np.radians(23.45) * np.sin(2 * np.pi * (284 + day_of_year) / 365)
    # 10 degrees east are 20 minutes behind Central European Time; the equation of time takes 11 to 14 more.
    hour_angle = np.radians(15 * (HOUR - 12 - 20 / 60 - 12.5 / 60))
    latitude = np.radians(53.5)
    height = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(
        hour_angle
    )
    assert (RECORDING["IrrGH_W_m2"] <= 0.85 * 1395 * np.maximum(height, 0) + 25).all()
    assert (RECORDING.loc[height < -0.08, "IrrGH_W_m2"] == 0).all()
    assert RECORDING.loc[height > 0.2, "IrrGH_W_m2"].min() > 0


def test_grey_box_fits_as_well_as_found_by_hand_and_not_perfectly():
    case = load_case(REPOSITORY / "fmus" / "office" / "case.toml")
    assert case.window_d == (0, 10)
    with case.open_model() as model:
        answer = model.simulate(BEST[None])
    mse = float(np.mean((answer.y[0] - case.measurement.y) ** 2))
    assert mse == pytest.approx(BEST_MSE, rel=5e-3)
