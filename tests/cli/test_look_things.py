"""`studies show`, `compare`, `best` and `--dry-run` on a real small project, made once."""

import hashlib
import json
import re
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, make_project

from studies.cli import main
from studies.looking.comparable import Comparable
from studies.looking.curve import plot, sparkline
from studies.looking.mlflow_runs import find_runs
from studies.looking.verdict import verdict
from studies.paths import ProjectPaths

LABEL = "office-smoke"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A project in which everything of the smoke profile was run."""
    root = make_project(tmp_path_factory.mktemp("looking") / "project")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STUDIES_ROOT", str(root))
        patch.chdir(root)
        assert main(["run", "--profile", "smoke", "--trials", "3", "--quiet", "--json"]) == 0
        yield root


@pytest.fixture(autouse=True)
def inside(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STUDIES_ROOT", str(finished))
    monkeypatch.chdir(finished)


def names(root: Path) -> dict[str, str]:
    """Return everything that can be shown, and what it is."""
    study = json.loads(next((root / "mlruns" / "trials" / LABEL).glob("n0016-*/study.json")).read_text())
    row_set = next((root / "data" / "office" / "generated" / "sets").glob("train-*.npz"))
    champion = json.loads((root / "mlruns" / "champions" / LABEL / "n0016" / "champion.json").read_text())
    return {
        LABEL: "label",
        f"{LABEL}/n0016": "study",
        study["name"]: "study",
        study["name"].rsplit("/", 1)[1]: "study",
        "n16": "study",
        f"{LABEL}/n0016/t000": "trial",
        f"{study['name']}/t001": "trial",
        "n16/t0": "trial",
        f"mlruns/champions/{LABEL}/n0016": "trial",
        champion["run_id"]: "trial",
        champion["run_id"][:9]: "trial",
        f"{LABEL}/calibrate-n0016": "calibration",
        "calibration-n0016": "calibration",
        f"mlruns/results/{LABEL}/calibration-n0016.json": "calibration",
        "sensitivity": "stage",
        f"{LABEL}/check": "stage",
        row_set.stem: "row set",
        str(row_set): "row set",
        study["digests"]["case"][:7]: "digest",
    }


def test_everything_can_be_shown_under_each_of_its_names(finished: Path, studies: Run) -> None:
    for name, kind in names(finished).items():
        assert studies("show", name, "--json").document["kind"] == kind, name
    for name in (LABEL, "n16", "n16/t0", "calibrate-n0016", "sensitivity", "check", "simulate", "report"):
        answer = studies("show", name)
        assert answer.code == 0, answer.err
        assert answer.out.splitlines()[-1].startswith("next: studies ")


def test_what_was_changed_stands_in_the_commands_that_do_it_again(finished: Path) -> None:
    page = (finished / "mlruns" / "reports" / LABEL / "index.html").read_text(encoding="utf-8")
    assert "studies run office --profile smoke --trials 3\n" in page
    recipes = [
        json.loads(file.read_text(encoding="utf-8"))["recipe"]["command"]
        for file in (finished / "mlruns" / "trials" / LABEL).glob("*/study.json")
    ]
    assert recipes == ["studies tune office --profile smoke --trials 3"] * 2


def test_a_trial_is_shown_with_its_curve_its_run_and_its_lineage(studies: Run) -> None:
    answer = studies("show", "n16/t0")
    shown = answer.out
    assert "1 of" in shown
    assert "limit of epochs reached after 30 epochs" in shown
    assert "MAE on the validation set [K]" in shown
    assert "studies reproduce office-smoke/n0016/t000" in shown
    assert "case office" in shown
    document = studies("show", "n16/t0", "--json").document
    assert document["lineage"]["made_from"]
    (run,) = find_runs(ProjectPaths(Path.cwd()), tag=("trial_key", f"{document['study']}/t000"))
    assert run.run_id in shown
    with sqlite3.connect(Path("mlruns/mlflow.db")) as database:
        wanted = "SELECT value FROM metrics WHERE run_uuid = ? AND key = 'val/mae' ORDER BY step DESC LIMIT 1"
        (logged,) = database.execute(wanted, (run.run_id,)).fetchone()
    database.close()
    assert logged == document["metrics"]["val/mae"]


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ("office-smoke/n0016/t077", "office-smoke/n0016 has the trials t000 to t002"),
        ("office-smok", "did you mean office-smoke?"),
        ("t0", "may be"),
        ("abcdef012345", "nothing is called 'abcdef012345'"),
        ("mlruns/results/office-smoke/history.npz", "nothing is called 'mlruns/results/office-smoke/"),
        ("mlruns/trials/office-smoke/trial.json", "nothing is called 'mlruns/trials/office-smoke/trial"),
    ],
)
def test_a_name_that_means_nothing_or_too_much_is_refused_in_one_line(
    studies: Run, wrong: str, line: str
) -> None:
    answer = studies("show", wrong)
    assert answer.code == 2
    assert line in answer.err
    assert answer.err.count("\n") == 1


def test_compare_says_what_differs_and_by_how_much(studies: Run) -> None:
    document = studies("compare", "n16/t0", "n16/t1", "--json").document
    first, second = (studies("show", f"n16/t{i}", "--json").document for i in (0, 1))
    assert document["is_comparable"]
    assert document["differs"]["seed"] == [first["seed"], second["seed"]]
    assert "n_train" not in document["differs"]
    expected = second["metrics"]["val/mae"] / first["metrics"]["val/mae"]
    assert document["results"]["val/mae"]["ratios"] == [1.0, pytest.approx(expected)]
    told = studies("compare", "n16/t0", "n16/t1").out
    assert "what differs" in told
    assert told.rstrip().endswith(document["verdict"])


@pytest.mark.parametrize(
    ("kind", "results", "judged", "differing", "said"),
    [
        (
            "trial",
            ({"val/mae": 1.0, "test/mae": 2.0}, {"val/mae": 0.9, "test/mae": 2.5}),
            ({}, {}),
            ["n_train"],
            "A is better in test error (20.0 % lower); B in validation error (10.0 % lower). "
            "One seed each: the same with other seeds (--seed) tells how much of it is chance.",
        ),
        (
            "study",
            ({"val/mae": 1.0, "test/mae": 2.0}, {"val/mae": 0.9, "test/mae": 2.0}),
            ({"validation": "1", "test": "3"}, {"validation": "2", "test": "3"}),
            ["seed"],
            "Equal in test error.",
        ),
        ("trial", ({"val/mae": 1.0}, {}), ({}, {}), [], "No verdict: nothing was judged on the same data"),
        (
            "calibration",
            ({"final MSE": 4.0, "calls (paper)": 50}, {"final MSE": 1.0, "calls (paper)": 50}),
            ({"case": "1"}, {"case": "1"}),
            ["seed", "best: beta"],
            "B is better in MSE (75.0 % lower); equal: model calls. Only the seed differs: so much is",
        ),
        (
            "label",
            ({"n0016: val/mae": 1.0, "n0032: val/mae": 0.5}, {"n0016: val/mae": 2.0, "n0032: val/mae": 0.6}),
            ({}, {}),
            ["sizes"],
            "A is better in validation error (2 of 2 sizes). One seed each",
        ),
    ],
)
def test_the_verdict_says_who_is_better_at_what(
    kind: str,
    results: tuple[dict[str, float], ...],
    judged: tuple[dict[str, str], ...],
    differing: list[str],
    said: str,
) -> None:
    sides = [
        Comparable("", "K", digests, {}, values) for digests, values in zip(judged, results, strict=True)
    ]
    assert verdict(kind, sides, differing).startswith(said)


def test_best_of_a_size_that_is_not_there_names_those_that_are(studies: Run) -> None:
    answer = studies("best", "--n-train", "16", "99")
    assert answer.code == 2
    assert "no model of n_train = 99, there are 16, 32" in answer.err


def test_studies_are_compared_at_equal_numbers_of_trials(studies: Run) -> None:
    results = studies("compare", "n16", "n32", "--json").document["results"]
    counted = [int(name.split()[-1]) for name in results if "best of first" in name]
    assert counted == [1, 2, 3]
    course = [results[f"val/mae, best of first {n}"]["values"][0] for n in counted]
    assert course == sorted(course, reverse=True)
    assert studies("compare", "calibrate-n0016", "calibrate-n0032").code == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("n16", "n16/t0"), "compare things of one kind"),
        (("n16", "n16"), "is named twice"),
        (("check", "simulate"), "what can be compared are"),
    ],
)
def test_what_cannot_be_compared_is_refused(studies: Run, words: tuple[str, str], line: str) -> None:
    answer = studies("compare", *words)
    assert answer.code == 2
    assert line in answer.err


def test_the_lines_that_best_prints_load_the_champion(studies: Run) -> None:
    out = studies("best").out
    code = "\n".join(
        line.strip() for line in out.splitlines() if re.match(r"  (from|surrogate,|y =) ?", line)
    )
    scope: dict[str, object] = {"theta": np.full((2, 14), np.nan)}
    champion = json.loads(Path(f"mlruns/champions/{LABEL}/n0016/champion.json").read_text())
    scope["theta"] = np.array([champion["lower"], champion["upper"]])
    exec(code, scope)
    assert np.isfinite(np.asarray(scope["y"])).all()


def test_a_dry_run_knows_what_is_finished_and_writes_nothing(finished: Path, studies: Run) -> None:
    before = snapshot(finished)
    again = studies("run", "--profile", "smoke", "--trials", "3", "--dry-run", "--json").document
    assert {step["what"]: step["to_do"] for step in again["steps"] if step["to_do"]} == {}
    assert again["seconds"] == 0.0
    assert {step["basis"] for step in again["steps"] if step["what"].startswith("tune: ")} == {""}
    more = studies(
        "tune", "--profile", "smoke", "--trials", "5", "--n-train", "16", "64", "--dry-run", "--json"
    )
    steps = {step["what"]: step for step in more.document["steps"]}
    assert (steps["simulate: training"]["to_do"], steps["simulate: training"]["planned"]) == (32, 64)
    assert (steps["tune: n0016"]["to_do"], steps["tune: n0064"]["to_do"]) == (2, 5)
    assert steps["tune: n0016"]["basis"].endswith("mean of 3 trials")
    assert all(step["seconds"] is not None for step in steps.values())
    assert "nothing is written" in studies("run", "--profile", "smoke", "--seed", "5", "--dry-run").out
    assert snapshot(finished) == before


def test_epochs_are_timed_on_the_device_of_the_trials(
    tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = tmp_path / "device.toml"
    profile.write_text(
        'name = "device"\n[data]\nn_train = [128]\n[tuning]\nn_trials = 1\nvariant = "refined"\n'
        'device = "cuda"\n',
        encoding="utf-8",
    )
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    answer = studies("tune", "--profile", str(profile), "--dry-run")
    assert answer.code == 2
    assert "profile device: device 'cuda' asked for" in answer.err.splitlines()[-1]


def snapshot(root: Path) -> dict[str, str]:
    """Return the content of all files."""
    files = (file for file in root.rglob("*") if file.is_file())
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_a_plot_shows_first_last_least_and_most() -> None:
    x = np.arange(1.0, 101.0)
    drawn = plot(x, 1.0 / x, x_name="epoch", y_name="error")
    lines = drawn.splitlines()
    assert lines[0] == "error, logarithmic"
    assert lines[1].startswith("   1 ┤")
    assert lines[8].startswith("0.01 ┤")
    assert lines[-1].split() == ["1", "epoch", "100"]
    # Where the curve falls, the dots lie further down from line to line.
    firsts = [len(line) - len(line.split("┤")[1].lstrip("⠀")) for line in lines[1:9]]
    assert firsts == sorted(firsts)
    assert plot(np.array([1.0]), np.array([1.0]), x_name="", y_name="") == ""
    assert plot(x, np.full(100, np.nan), x_name="", y_name="") == ""
    assert sparkline(np.array([1.0, np.nan, 8.0])) == "▁ █"
