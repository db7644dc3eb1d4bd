"""The embedded case of eight experiments, through the public command: the truth is found in a few rows."""

from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, add_case

TRUTH = {"C1": 1.3e6, "C2": 8e5, "CWall": 5.2e6, "G1": 26, "G2": 17, "GWall": 62, "A1": 1.4, "A2": 0.55}


@pytest.mark.slow
def test_seven_experiments_find_what_all_share_and_predict_the_eighth(project: Path, studies: Run) -> None:
    add_case(project, "two-rooms")
    found = studies("calibrate", "two-rooms", "--jobs", "2", "--json").stage

    # Four simulations with the door shut, one with it open; these five are worth one row of seven.
    assert found["state_equations"]["n_alone"] == 5
    assert found["ledger"]["n_adaptive"] == 2
    assert found["state_equations"]["are_believed"]
    for name, value in TRUTH.items():
        assert abs(np.log(found["theta"][name] / value)) < 0.01, name
    assert len([name for name in found["theta"] if name.startswith("TWallStart@")]) == 7
    held_out = found["validation"]["points"]["calibrated"]["outputs"]
    # The noise is 0.05 K.
    assert {name: one["rmse"] < 0.07 for name, one in held_out.items()} == dict.fromkeys(held_out, True)
