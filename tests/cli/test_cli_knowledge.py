"""What the user knows: priors in the case file."""

from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, copy_of, make_project

from simulation.case import load_case
from studies.doctor.declared import look_at_declaration

ADAPTIVE = ("calibrate", "office", "--jobs", "1")
PRIOR = 'name = "UWin"\nprior = { about = 0.75, within_factor = 1.05 }\n'


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with an empty MLflow store, which takes seconds to make."""
    return make_project(tmp_path_factory.mktemp("template") / "project")


@pytest.fixture
def project(template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(template, tmp_path / "project", monkeypatch)


def with_prior(project: Path, text: str = PRIOR) -> None:
    case = project / "fmus" / "office" / "case.toml"
    content = case.read_text(encoding="utf-8")
    assert 'name = "UWin"\n' in content
    case.write_text(content.replace('name = "UWin"\n', text), encoding="utf-8")


def test_a_prior_costs_no_simulation_again_and_is_shown(project: Path, studies: Run) -> None:
    before = studies(*ADAPTIVE, "--max-calls", "15", "--json").stage
    assert "prior" not in before
    with_prior(project)
    judged = studies("uncertainty", "office")
    assert judged.code == 2
    assert "is of another window, measurement, scale or prior); type: studies calibrate office" in judged.err
    after = studies(*ADAPTIVE, "--max-calls", "15", "--json").stage
    assert not after["finished_before"]
    assert after["n_simulated"] <= 15 - 10, "the first design is stored"
    one = after["prior"]["parameters"]["UWin"]
    moved = np.log(after["theta"]["UWin"] / 0.75) / np.log(1.05)
    assert one["moved_deviations"] == pytest.approx(moved, rel=1e-6)
    assert after["prior"]["penalty"] == pytest.approx(after["prior"]["weight"] * moved**2, rel=1e-6)
    said = studies(*ADAPTIVE, "--max-calls", "15").out
    assert "One standard deviation of a prior weighs as much as" in said
    assert "known before: 0.75 ×/÷ 1.05" in said
    (priors,) = [
        one for one in look_at_declaration(load_case(project / "fmus" / "office")) if one.what == "priors"
    ]
    assert "UWin of 14 parameters" in priors.found


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ("{ about = 0.75, within = 0.1 }", 'prior does not fit scale = "log"; write within_factor'),
        ("{ about = 0.75 }", 'prior does not fit scale = "log"; write within_factor'),
        (
            "{ abut = 0.75, within_factor = 2 }",
            "unknown key parameters[UWin].prior.abut (did you mean about?)",
        ),
        ("{ about = 75, within_factor = 2 }", "prior: about = 75 lies outside the bounds"),
        ("{ about = 0.75, within_factor = 0.5 }", "within_factor = 0.5; give a number above 1"),
        ("0.75", "parameters[UWin].prior = 0.75: "),
    ],
)
def test_a_wrong_prior_is_one_line(project: Path, studies: Run, prior: str, message: str) -> None:
    with_prior(project, f'name = "UWin"\nprior = {prior}\n')
    answer = studies(*ADAPTIVE)
    assert answer.code == 2
    assert message in answer.err
    assert answer.err.strip().count("\n") == 0
