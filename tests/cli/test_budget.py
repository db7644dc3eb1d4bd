"""A run within a budget of simulations: counted at the store, cross-validated, the same when typed again."""

from pathlib import Path

import pytest
from made_once import made_once
from project_for_tests import Run, add_case, copy_of, edit, make_project, stored_simulations

from studies.cli import main

pytestmark = pytest.mark.slow

PROFILE = """\
schema = 1
name = "tiny"
[budget]
simulations = {n}
[data]
folds = 3
[tuning]
surrogate = "pca-gp"
n_trials = 1
max_epochs = 4
[screening]
popsize = 4
maxiter = 5
"""
BUDGET = 44
RUN = ("run", "wall", "--profile", "tiny.toml", "--jobs", "2")


def _made(root: Path) -> None:
    add_case(make_project(root))
    (root / "tiny.toml").write_text(PROFILE.format(n=BUDGET), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        assert main([*RUN, "-q"]) == 0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "budget", _made)


@pytest.fixture
def project(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(made, tmp_path / "project", monkeypatch)


def test_all_that_a_run_simulates_is_within_its_budget(project: Path, studies: Run) -> None:
    answer = studies(*RUN, "--json")
    document = answer.document
    calibrated = [one for one in document["stages"] if one["stage"].startswith("calibrate")]
    stored = sum(map(len, stored_simulations(project, "wall").values()))

    spent = document["simulations"]
    assert spent["budget"] == BUDGET
    # What is in no store: the best row of each size, once more.
    assert stored + sum(one["n_repeated"] for one in calibrated) == spent["used"] <= BUDGET
    assert len(calibrated) == 2
    assert calibrated[-1]["n_train"] > calibrated[0]["n_train"]
    # The validation period's simulation is one of them, and no set judges alone.
    assert set(calibrated[-1]["validation"]["points"]) == {"polished"}
    assert calibrated[-1]["ledger"]["n_validation"] == calibrated[-1]["ledger"]["n_test"] == 0
    # Typed again, all is finished.
    assert "finished before" in answer.err
    assert stored == sum(map(len, stored_simulations(project, "wall").values()))


def test_the_surrogate_is_cross_validated_and_gives_the_indices(project: Path, studies: Run) -> None:
    stages = studies(*RUN, "--json").document["stages"]
    tuned = next(one for one in stages if one["stage"] == "tune")["studies"]
    indices = next(one for one in stages if one["stage"] == "sensitivity")

    for size in tuned:
        assert size["folds"] == 3
        assert size["mae"] == size["metrics"]["cv/mae"] < size["p90"]
        assert not [name for name in size["metrics"] if name.startswith(("val/", "test/"))]
    assert indices["n_train"] == tuned[-1]["n_train"]
    page = project / "mlruns" / "reports" / "wall-tiny" / "index.html"
    assert "cross-validated" in page.read_text(encoding="utf-8")


def test_trials_and_calibrations_are_reproduced(project: Path, studies: Run) -> None:
    stages = studies(*RUN, "--json").document["stages"]
    run_id = next(one for one in stages if one["stage"] == "tune")["studies"][-1]["run_id"]
    for name in (run_id, "wall-tiny/" + stages[-2]["stage"].removeprefix("calibrate-")):
        assert "equal: all" in studies("reproduce", name).out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--simulations", "17"), "--simulations 17 is not enough for"),
        (("--simulations", "40", "--n-train", "38"), "--n-train 38 leaves too little of --simulations 40"),
        (("--simulations", "few"), "--simulations"),
    ],
)
def test_a_budget_that_holds_nothing_is_refused(
    project: Path, studies: Run, options: tuple[str, ...], said: str
) -> None:
    answer = studies("run", "wall", *options)
    assert answer.code == 2
    assert said in answer.err
    assert len(answer.err.strip().splitlines()) == 1


def test_without_a_budget_sizes_have_to_be_given(project: Path, studies: Run) -> None:
    edit(project / "tiny.toml", (f"simulations = {BUDGET}", ""))
    answer = studies(*RUN)
    assert answer.code == 2
    assert "data.n_train is missing" in answer.err


def test_a_dry_run_says_how_many_and_simulates_nothing(project: Path, studies: Run) -> None:
    before = stored_simulations(project, "wall")
    (plan,) = studies("run", "wall", "--simulations", "50", "--dry-run", "--json").document["plan"]
    assert plan["n_simulations"] == 50
    assert plan["simulations_s"] > 0.0
    assert stored_simulations(project, "wall").keys() == before.keys()
