"""What the user knows: priors in the case file."""

from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, add_case

ADAPTIVE = ("calibrate", "wall", "--jobs", "1", "--no-state-equations", "--max-calls", "12")
N_DESIGN = 7
PRIOR = 'name = "GIn"\nprior = { about = 75, within_factor = 1.05 }\n'


@pytest.mark.slow
def test_a_prior_costs_no_simulation_again_and_is_shown(project: Path, studies: Run) -> None:
    case = add_case(project)
    before = studies(*ADAPTIVE, "--json").stage
    assert "prior" not in before
    case.write_text(case.read_text(encoding="utf-8").replace('name = "GIn"\n', PRIOR), encoding="utf-8")
    judged = studies("uncertainty", "wall")
    assert judged.code == 2
    assert (
        "there is none of this window, measurement, scale and prior; type: studies calibrate wall"
        in judged.err
    )
    after = studies(*ADAPTIVE, "--json").stage
    assert not after["finished_before"]
    assert after["n_simulated"] <= 12 - N_DESIGN, "the first design is stored"
    one = after["prior"]["parameters"]["GIn"]
    moved = np.log(after["theta"]["GIn"] / 75.0) / np.log(1.05)
    assert one["moved_deviations"] == pytest.approx(moved, rel=1e-6)
    assert after["prior"]["penalty"] == pytest.approx(after["prior"]["weight"] * moved**2, rel=1e-6)
    said = studies(*ADAPTIVE).out
    assert "One standard deviation of a prior weighs as much as" in said
    assert "known before: 75 ×/÷ 1.05" in said
