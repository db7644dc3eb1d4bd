"""What the user knows: priors in the case file, and parameters fixed because they matter least."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project_for_tests import TINY_PROFILE, Run, copy_of, make_project

from simulation.case import load_case
from studies.doctor.declared import look_at_declaration
from studies.sensitivity import SobolIndices

ADAPTIVE = ("calibrate", "office", "--jobs", "1")
PRIOR = 'name = "UWin"\nprior = { about = 0.75, within_factor = 1.05 }\n'
SOBOL = TINY_PROFILE.replace("tiny", "sobol") + "[sensitivity]\nn_base = 8\n"
P, N_MORRIS, N_CHECK = 14, 60, 15


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


def stored(project: Path, name: str, label: str = "office-quick") -> dict[str, Any]:
    file = project / "mlruns" / "results" / label / f"calibration-{name}.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


def test_a_prior_costs_no_simulation_again_and_is_told(project: Path, studies: Run) -> None:
    before = studies(*ADAPTIVE, "--max-calls", "15", "--json").stage
    assert "prior" not in before
    with_prior(project)
    judged = studies("uncertainty", "office")
    assert judged.code == 2
    assert "is of another window, measurement, scale or prior); type: studies calibrate office" in judged.err
    after = studies(*ADAPTIVE, "--max-calls", "15", "--json").stage
    assert not after["finished_before"]
    assert after["n_simulated"] <= 15 - 10, "the first design is stored"
    assert after["case_sha256"] == before["case_sha256"]
    one = after["prior"]["parameters"]["UWin"]
    moved = np.log(after["theta"]["UWin"] / 0.75) / np.log(1.05)
    assert one["moved_deviations"] == pytest.approx(moved, rel=1e-6)
    assert after["prior"]["penalty"] == pytest.approx(after["prior"]["weight"] * moved**2, rel=1e-6)
    told = studies(*ADAPTIVE, "--max-calls", "15").out
    assert "parameters held by a prior" in told
    assert "0.75 ×/÷ 1.05" in told
    assert "no limits, the zero of a temperature is a convention" in told
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


def test_the_most_relevant_are_calibrated_and_the_others_stay(project: Path, studies: Run) -> None:
    with_prior(project)
    whole = studies(*ADAPTIVE, "--max-calls", "15", "--json").stage
    kept = stored(project, "adaptive")
    restricted = (*ADAPTIVE, "--most-relevant", "3", "--max-calls", "90")
    first = studies(*restricted, "--json")
    assert f"relevance: by Morris' elementary effects, {N_MORRIS} calls, counted" in first.err
    found, told = first.stage, first.stage["restriction"]
    assert (told["n_free"], len(told["fixed"]), told["source"]) == (3, P - 3, "Morris")
    assert {name: found["theta"][name] for name in told["fixed"]} == told["fixed"]
    assert set(told["why"].values()) - {"its prior"} == {"its estimate"}
    least_free = min(told["shares"][name] for name in found["theta"] if name not in told["fixed"])
    assert least_free >= max(told["shares"][name] for name in told["fixed"])
    ledger = found["ledger"]
    assert ledger["n_relevance"] == N_MORRIS + N_CHECK
    assert ledger["total_paper"] == ledger["n_relevance"] + ledger["n_adaptive"] <= 90
    assert set(told["check"]["gain_alone"]) == set(told["fixed"])
    assert stored(project, "adaptive") == kept
    again = studies(*restricted)
    assert "finished before" in again.err
    assert f"{ledger['total_paper']} model calls" in again.out
    assert f"stored calibration of all parameters ({whole['ledger']['total_paper']} calls)" in again.out
    assert "freed, they would gain" in again.out
    page = studies("report", "office", "--json")
    folder = (project / page.document["stages"][0]["index"]).parent
    assert "fixed at its estimate" in (folder / "parameters-adaptive-relevant3.csv").read_text(
        encoding="utf-8"
    )
    assert "prior 0.75 ×/÷ 1.05, moved by" in (folder / "parameters-adaptive.csv").read_text(encoding="utf-8")
    assert "How sure it is: studies uncertainty office --most-relevant 3\n" in again.out
    commands = (folder / "index.html").read_text(encoding="utf-8")
    assert "Least relevant calibrated: " in commands
    assert "What the fixing cost: the MSE is " in commands
    for words in ("--max-calls 15\n", "--max-calls 90 --most-relevant 3\n"):
        assert f"studies calibrate office {words}" in commands
    again = studies("reproduce", "office-quick/adaptive-relevant3", "--json")
    assert again.code == 0, again.err
    assert again.document["equal"]


def test_stored_sobol_indices_say_it_without_a_call(project: Path, studies: Run) -> None:
    (project / "sobol.toml").write_text(SOBOL, encoding="utf-8")
    profile = ("--profile", "sobol.toml")
    assert studies("sensitivity", "office", *profile, "--jobs", "1").code == 0
    first = studies(*ADAPTIVE, *profile, "--most-relevant", "3", "--max-calls", "9", "--json")
    assert "relevance: by the stored Sobol indices, 128 calls before, not counted" in first.err
    found = first.stage
    assert (found["restriction"]["source"], found["restriction"]["n_calls"]) == ("Sobol", 0)
    assert found["restriction"]["n_calls_before"] == 8 * (P + 2)
    assert found["restriction"]["check"] is None
    assert found["ledger"]["total_paper"] == found["ledger"]["n_adaptive"] <= 9
    told = studies(*ADAPTIVE, *profile, "--most-relevant", "3", "--max-calls", "9").out
    assert "the stored Sobol indices had cost 128 calls" in told
    assert "not known, the budget held no check of it" in told
    answer = studies("uncertainty", "office", *profile)
    assert answer.code == 2
    assert "but adaptive-relevant3, which fixed some parameters; type: studies uncertainty" in answer.err
    file = project / "mlruns" / "results" / "office-sobol" / "sensitivity.npz"
    indices = SobolIndices.load(file)
    replace(indices, total_order=indices.total_order[..., ::-1]).save(file)  # done again, other rows failed
    again = studies(*ADAPTIVE, *profile, "--most-relevant", "3", "--max-calls", "9", "--json").stage
    assert not again["finished_before"]
    assert again["restriction"]["fixed"] != found["restriction"]["fixed"]


def test_the_papers_method_fixes_them_in_surrogate_and_model(
    finished: Path, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = copy_of(finished, tmp_path / "project", monkeypatch)
    kept = stored(root, "n0016", "office-tiny")
    found = studies(
        "calibrate", "--profile", "tiny.toml", "--n-train", "16", "--most-relevant", "3", "--max-calls", "19",
        "--json",
    ).stage  # fmt: skip
    told = found["restriction"]
    for point in ("theta", "theta_screened"):
        assert {name: found[point][name] for name in told["fixed"]} == told["fixed"]
    ledger = found["ledger"]
    assert ledger["n_relevance"] == N_MORRIS + (told["check"] or {"n_calls": 0})["n_calls"]
    assert (
        ledger["total_paper"] == 16 + ledger["n_screen_checks"] + ledger["n_polish"] + ledger["n_relevance"]
    )
    assert stored(root, "n0016", "office-tiny") == kept
    numbers = stored(root, "n0016-relevant3", "office-tiny")
    assert numbers["theta"] == found["theta"]
    with np.load(root / "mlruns/results/office-tiny/calibration-n0016-relevant3.npz") as arrays:
        assert numbers["polish_history"]["n_calls"] == arrays["history_calls"].tolist()
        assert arrays["history_calls"][0] == N_MORRIS + 16 + ledger["n_screen_checks"]
    page = studies("report", "--profile", "tiny.toml")
    assert page.code == 0, page.err
    told = json.loads((root / "mlruns/reports/office-tiny/report.json").read_text(encoding="utf-8"))
    rows = {row["n_free"]: row for row in told["tables"]["calibrations"]}
    assert (rows[3]["calls_paper"], rows[P]["n_train"]) == (ledger["total_paper"], 16)
    assert numbers["recipe"]["command"] == (
        "studies calibrate office --profile tiny.toml --max-calls 19 --method paper --n-train 16 "
        "--most-relevant 3"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--most-relevant", "14"),
            "--most-relevant 14 fixes nothing, office has 14 parameters; give at most 13",
        ),
        (
            ("--most-relevant", "3", "--max-calls", "50"),
            "does not hold 60 simulations to find the relevant parameters and the first design of 4 "
            "simulations for 3 parameters; give 68 or more",
        ),
        (("--most-relevant", "0"), "--most-relevant"),
    ],
)
def test_what_cannot_be_restricted_is_one_line(
    project: Path, studies: Run, arguments: tuple[str, ...], message: str
) -> None:
    answer = studies(*ADAPTIVE, *arguments)
    assert answer.code == 2
    assert message in answer.err
