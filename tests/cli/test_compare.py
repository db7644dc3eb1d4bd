"""`studies compare`: two labels side by side, and which is better beyond the noise, without a training."""

from pathlib import Path
from typing import Any

import optuna
import pytest
from project_for_tests import Run
from studies_for_tests import SPACE, declared, write_study

from simulation.record_file import write_json
from studies import InputError, compare
from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.tuning.attempts import CONFIRMATION, DECLARATION, PROPOSED_BY, RUN_ID
from studies.tuning.storage import open_storage

POINT = {"n_latent": 64, "n_hidden": 128, "beta": 100.0}


def add_label(root: Path, label: str, errors: dict[int, tuple[float, ...]], **changes: Any) -> None:
    """Add studies of one trial each; further errors are those of further seeds."""
    for n_train, (error, *seeds) in errors.items():
        spec = declared(label, n_train, **changes)
        write_study(root, spec, n_trials=0)
        _add(root, spec, error, "default")
        for one in seeds:
            _add(root, spec.confirmation, one, CONFIRMATION)


def _add(root: Path, spec: Declaration, error: float, proposed_by: str) -> None:
    storage = open_storage(ProjectPaths(root))
    study = optuna.create_study(storage=storage, study_name=spec.name, load_if_exists=True)
    study.set_user_attr(DECLARATION, spec.to_dict())
    attrs = {RUN_ID: f"{spec.name}{len(study.trials)}", PROPOSED_BY: proposed_by, "val/p90": 2.0 * error}
    study.add_trial(optuna.create_trial(value=error, params=POINT, distributions=SPACE, user_attrs=attrs))


@pytest.fixture
def project(new_project: Path) -> Path:
    """Two profiles of the office, two sizes of which were confirmed in both."""
    quick = {64: (0.30, 0.31, 0.33), 128: (0.2, 0.20, 0.22, 0.21), 256: (0.11,), 512: (0.1, 0.1, 0.1)}
    thorough = {64: (0.29, 0.30, 0.34), 128: (0.1, 0.12, 0.10, 0.11), 256: (0.10,), 512: (0.2, 0.2, 0.2)}
    add_label(new_project, "office-quick", quick)
    add_label(new_project, "office-thorough", {**thorough, 1024: (0.05,)})
    sets = {"n": {"train": 512, "validation": 320, "test": 300}}
    empty = {"n_failed": {}, "first_failures": [], "files": {}, "digests": {}, "store": "", "n_reused": 0}
    about = {"digest": "d", "wall_s": 1.0, "finished": "2026-01-01", "inputs": {}}
    folder = ProjectPaths(new_project).results("office-quick")
    folder.mkdir(parents=True)
    write_json(folder / "simulate.json", {**about, "result": sets | empty})
    return new_project


@pytest.mark.usefixtures("project")
def test_each_size_says_which_label_is_better_beyond_the_noise(studies: Run) -> None:
    answer = studies("compare", "quick", "thorough", "--json")
    assert answer.code == 0
    document = answer.document
    assert (document["first"], document["second"]) == ("office-quick", "office-thorough")
    assert [(one["n_train"], one["better"]) for one in document["sizes"]] == [
        (64, ""), (128, "office-thorough"), (256, ""), (512, "office-quick"), (1024, ""),
    ]  # fmt: skip
    verdicts = [one["verdict"] for one in document["sizes"]]
    assert verdicts[0] == "no difference beyond the noise"
    assert verdicts[1].startswith("office-thorough is better by 0.10, p = 0.000")
    assert verdicts[2] == "not known: one seed each"
    assert verdicts[4] == "one label has no complete trial"
    first = document["sizes"][1]["first"]
    # The mean of the further seeds, without the trial that was chosen because it was good.
    assert first["mae"] == pytest.approx(0.21)
    assert first["mae_deviation"] == pytest.approx(0.01)
    assert first["p90"] == pytest.approx(0.42)
    assert (first["n_seeds"], first["n_trials"], first["params"]) == (3, 1, POINT)
    assert first["n_simulations"] == 128 + 320 + 300
    alone = document["sizes"][2]["first"]
    assert (alone["mae"], alone["mae_deviation"], alone["n_seeds"]) == (0.11, None, 1)
    assert document["sizes"][0]["second"]["n_simulations"] is None
    assert document["sizes"][4]["first"] is None


@pytest.mark.usefixtures("project")
def test_a_person_sees_the_same(studies: Run) -> None:
    text = " ".join(studies("compare", "office-quick", "*thorough").out.split())
    for words in ("0.210 ± 0.010", "no difference", "one seed each", "office-thorough is"):
        assert words in text


def test_one_seed_or_other_rows_decide_nothing(project: Path) -> None:
    add_label(project, "office-lucky", {64: (0.01,)})
    digests = declared("x", 64).digests | {"validation": "9" * 64}
    add_label(project, "office-other", {64: (0.1, 0.1, 0.11)}, digests=digests)
    (size, *_) = compare("office-lucky", "office-quick").sizes
    assert (size.better, size.verdict) == ("", "not known: one seed of office-lucky")
    (size, *_) = compare("office-quick", "office-other").sizes
    assert (size.better, size.verdict) == ("", "not known: other rows judge")


@pytest.mark.usefixtures("project")
def test_in_python_it_is_a_table() -> None:
    table = compare("quick", "thorough").table
    assert list(table.index) == [64, 128, 256, 512, 1024]
    assert table.loc[128, "first.n_trials"] == 1
    assert table.loc[128, "better"] == "office-thorough"


@pytest.mark.parametrize("words", [("quick", "slow"), ("quick", "office"), ("office-quick", "quick")])
@pytest.mark.usefixtures("project")
def test_a_name_that_means_no_label_or_several_is_refused(studies: Run, words: tuple[str, str]) -> None:
    answer = studies("compare", *words)
    assert answer.code == 2
    assert "office-quick" in answer.err.splitlines()[-1]
    with pytest.raises(InputError, match=repr(words[1])):
        compare(*words)
