"""What the user knows: priors in the case file."""

from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, add_case

ADAPTIVE = ("calibrate", "wall", "--jobs", "1", "--no-state-equations", "--max-calls", "12")
N_DESIGN = 7
PRIOR = 'name = "GIn"\nprior = { about = 75, within_factor = 1.05 }\n'


@pytest.fixture
def project(project: Path) -> Path:
    """The project with the wall."""
    add_case(project)
    return project


def with_prior(project: Path, text: str = PRIOR) -> None:
    case = project / "fmus" / "wall" / "case.toml"
    content = case.read_text(encoding="utf-8")
    assert 'name = "GIn"\n' in content
    case.write_text(content.replace('name = "GIn"\n', text), encoding="utf-8")


def test_a_prior_costs_no_simulation_again_and_is_shown(project: Path, studies: Run) -> None:
    before = studies(*ADAPTIVE, "--json").stage
    assert "prior" not in before
    with_prior(project)
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


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ("{ about = 75, within = 0.1 }", 'prior does not fit scale = "log"; write within_factor'),
        (
            "{ abut = 75, within_factor = 2 }",
            "unknown key parameters[GIn].prior.abut (did you mean about?)",
        ),
        ("{ about = 7500, within_factor = 2 }", "prior: about = 7500 lies outside the bounds"),
        ("{ about = 75, within_factor = 0.5 }", "within_factor = 0.5; give a number above 1"),
    ],
)
def test_a_wrong_prior_is_one_line(project: Path, studies: Run, prior: str, message: str) -> None:
    with_prior(project, f'name = "GIn"\nprior = {prior}\n')
    answer = studies(*ADAPTIVE)
    assert answer.code == 2
    assert message in answer.err
    assert answer.err.strip().count("\n") == 0
