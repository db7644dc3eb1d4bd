"""A case of several experiments, from its file to values: one set of parameters that explains them all."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from made_once import made_once
from mlflow_store_for_tests import give_store
from project_for_tests import Run, add_case, copy_of, edit, make_project, stored_result, stored_simulations

from simulation.case import load_case
from studies.cli import main
from studies.paths import ProjectPaths
from studies.physical_model import store_file
from studies.results.saved import read_arrays

EXPERIMENTS = """
[[experiments]]
name = "first"
time = { window_d = [1, 3] }

[[experiments]]
name = "second"
time = { window_d = [3, 5], start_d = 2 }
outputs = [{ name = "TMasonry" }, { name = "QRoom", weight = 2.0 }]

[[experiments]]
name = "last"
time = { window_d = [5, 6], start_d = 4 }
fixed = { T2Start = 286.0 }
held_out = true
"""
CALIBRATE = ("calibrate", "wall", "--jobs", "2")


def with_experiments(file: Path, experiments: str = EXPERIMENTS) -> None:
    """Turn the wall's one window into experiments; the masonry's first temperature is each one's own."""
    text = file.read_text(encoding="utf-8")
    text = text[: text.index("# Best")] if "# Best" in text else text[: text.index("[[references]]")]
    text = re.sub(r"validation_d = .*\n", "", text)
    text = text.replace('name = "T2Start"\n', 'name = "T2Start"\nper_experiment = true\n')
    file.write_text(text + experiments, encoding="utf-8")


def _calibrated(root: Path) -> None:
    with_experiments(add_case(make_project(root)))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        assert main([*CALIBRATE, "-q"]) == 0


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "experiments", _calibrated)


@pytest.fixture
def project(calibrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(calibrated, tmp_path / "project", monkeypatch)


def test_state_equations_of_both_experiments_find_what_each_alone_cannot(project: Path) -> None:
    found = stored_result(project)

    # Equations from one experiment, a row of both; what is held out is simulated for estimates and result.
    assert found["state_equations"]["n_alone"] <= 5
    assert found["ledger"]["n_adaptive"] <= 5
    assert found["state_equations"]["are_believed"]
    # The noise alone: 0.05 K.
    assert found["mse"] < 0.05**2
    assert set(found["theta"]) >= {"GIn", "C3", "T2Start@first", "T2Start@second"}
    assert set(found["outputs"]) == {f"{k}@{e}" for k in ("TMasonry", "QRoom") for e in ("first", "second")}
    assert set(found["validation"]["points"]["calibrated"]["outputs"]) == {"TMasonry@last", "QRoom@last"}


def test_every_experiment_has_its_rows_in_its_own_store(project: Path) -> None:
    plain = [rows for rows in stored_simulations(project, "wall").values() if "T1" not in rows.columns]
    sizes = sorted(len(rows) for rows in plain if "der(T1)" not in rows.columns)

    assert sizes == [1, 1, 2]


def test_typed_again_nothing_is_simulated_and_numbers_stay(project: Path, studies: Run) -> None:
    before = read_arrays(project / "mlruns/results/wall-quick/calibrate-adaptive.npz")
    (project / "mlruns/results/wall-quick/calibrate-adaptive.json").unlink()
    rows = {name: len(table) for name, table in stored_simulations(project, "wall").items()}
    answer = studies(*CALIBRATE)

    assert answer.code == 0, answer.err
    assert "in each of 2 experiments" in answer.out
    assert "In experiments first and second TMasonry@first differs by" in answer.out
    assert {name: len(table) for name, table in stored_simulations(project, "wall").items()} == rows
    after = read_arrays(project / "mlruns/results/wall-quick/calibrate-adaptive.npz")
    np.testing.assert_array_equal(after["y"], before["y"])


def test_a_held_out_experiment_is_predicted_beside_its_measurement(project: Path, studies: Run) -> None:
    stage = studies("predict", "wall", "--experiment", "last", "--json").stage
    table = np.genfromtxt(project / stage["table"], delimiter=",", names=True)
    case = load_case(project / "fmus" / "wall")
    assert case.validation is not None
    (held_out,) = case.validation.experiments

    y = np.column_stack([table["TMasonry"], table["QRoom"]])
    # Its first temperature is a guess.
    assert float(held_out.measurement.mse(y[None])[0]) < 1.0
    assert "--experiment" in studies("predict", "wall", "--experiment", "summer").err


def test_values_are_those_of_an_experiment(project: Path, studies: Run, tmp_path: Path) -> None:
    found = {}
    for name in ("first", "second", "last"):
        file = tmp_path / f"{name}.json"
        assert studies("best", "wall", "--experiment", name, "--write", "json", str(file)).code == 0
        content = json.loads(file.read_text())
        found[name] = {one["name"]: one["value"] for one in content["values"]}
    refused = studies("best", "wall", "--write", "json", str(tmp_path / "none.json"))

    assert found["first"]["GIn"] == found["second"]["GIn"] == found["last"]["GIn"]
    assert len({one["T2Start"] for one in found.values()}) == 3
    assert found["last"]["T2Start"] == 286.0
    assert refused.code == 2
    assert "name one of: first, second, last" in refused.err


@pytest.mark.slow
def test_check_examines_every_experiment(project: Path, studies: Run) -> None:
    found = studies("check", "wall", "--json").document["findings"]

    for name in ("first", "second", "last"):
        assert any(one["what"] == f"{name}: corners of the box" for one in found)
    # One verdict over all of them.
    assert sum(one["what"].endswith("every parameter moves an output") for one in found) == 1


def test_one_experiment_alone_is_the_same_as_its_window(tmp_path: Path) -> None:
    file = add_case(make_project(tmp_path / "one", with_store=False))
    plain = load_case(file, window_d=(1.0, 3.0))
    with_experiments(file, EXPERIMENTS.split("\n\n")[0].strip() + "\n")
    file.write_text(file.read_text().replace("per_experiment = true\n", ""))
    case = load_case(file)

    with case.experiments[0].open_model() as model, plain.open_model() as other:
        theta = case.parameter_space.expected[None]
        assert case.experiments[0].model_digest == plain.model_digest
        assert model.simulate(theta).digest == other.simulate(theta).digest
    np.testing.assert_array_equal(case.measurement.scales, plain.measurement.scales)


def test_an_experiment_may_be_driven_in_another_way(new_project: Path, studies: Run) -> None:
    first, second, _ = EXPERIMENTS.split("\n\n")
    give_store(new_project)
    with_experiments(add_case(new_project), f'{first}\n\n{second}\ninterface = "model-exchange"\n')

    found = studies("calibrate", "wall", "--json").stage
    assert found["mse"] < 0.05**2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "second"', 'name = "first"', "experiments[first] is declared 2 times"),
        ("time = { window_d = [3, 5]", "tine = { window_d = [3, 5]", "did you mean time?"),
        ("window_d = [3, 5]", "window_d = [3, 50]", "experiments[second]: "),
        (
            "fixed = { T2Start = 286.0 }\n",
            "",
            "has a value of its own in each experiment, and last is held out",
        ),
        ("start_d = 2 }", "start_d = 2, output_step_s = 1200 }", "give all the same output_step_s"),
        ('name = "TOut"\n', "", "key inputs[1].name is missing; add it"),
        ('name = "TOut"\n', 'name = ["TOut"]\n', "inputs[1].name: is no text"),
        ('name = "TOut"\n', 'name = "TIn"\n', "inputs[TIn] is declared 2 times"),
        ('{ name = "TMasonry" }', "{ weight = 1.0 }", "key experiments[second].outputs[0].name is missing"),
    ],
)
def test_what_is_wrong_is_one_line(old: str, new: str, message: str, new_project: Path, studies: Run) -> None:
    file = add_case(new_project)
    with_experiments(file)
    edit(file, (old, new))
    answer = studies("check", "wall")

    assert answer.code == 2
    assert message in answer.err
    assert len(answer.err.strip().splitlines()) == 1


@pytest.mark.slow
def test_the_paper_method_knows_experiments_and_constraints(project: Path, studies: Run) -> None:
    shutil.rmtree(project / "mlruns/results/wall-quick")
    file = project / "fmus/wall/case.toml"
    constrained = 'schema = 1\nconstraints = ["C1 < C2", "G23 < G12"]\n'
    file.write_text(file.read_text("utf-8").replace("schema = 1\n", constrained), "utf-8")
    known = {name: len(rows) for name, rows in stored_simulations(project, "wall").items()}
    (project / "tiny.toml").write_text(TINY)
    answer = studies("run", "wall", "--profile", "tiny.toml", "--jobs", "2", "--json")
    assert answer.code == 0, answer.err
    stages = {one["stage"]: one for one in answer.document["stages"]}

    assert stages["calibrate-n0016"]["mse"] < stages["calibrate-n0016"]["screening"]["mse"]
    # Designs, Sobol, the screened point and the polish.
    new = [rows[known.get(name, 0) :] for name, rows in stored_simulations(project, "wall").items()]
    assert sum(map(len, new)) > 50
    assert all((rows["C1"] <= rows["C2"]).all() and (rows["G23"] <= rows["G12"]).all() for rows in new)


TINY = """\
schema = 1
name = "tiny"
[data]
n_train = [16]
n_validation = 8
n_test = 8
[sensitivity]
n_base = 2
[tuning]
surrogate = "pca-gp"
n_trials = 1
max_epochs = 4
[screening]
popsize = 4
maxiter = 5
[polish]
max_calls = 30
"""


def test_a_damaged_list_of_the_experiments_stores_is_written_anew(project: Path, studies: Run) -> None:
    file = store_file(ProjectPaths(project), load_case(project / "fmus" / "wall"))
    simulate = ("simulate", "wall", "--profile", "smoke", "--jobs", "1", "--json")
    before, whole, rng = studies(*simulate).stage, file.read_bytes(), np.random.default_rng(0)
    for _ in range(3):
        damaged, place = bytearray(whole), int(rng.integers(8 * len(whole)))
        damaged[place // 8] ^= 1 << place % 8
        file.write_bytes(damaged)
        after = studies(*simulate).stage
        assert after["digests"] == before["digests"]
        assert after["n_reused"] == sum(after["n"].values())
        assert json.loads(file.read_bytes()) == json.loads(whole)
