"""Fig. 6 drawn from the trials of an earlier run: no recording, no simulation, no training."""

import io
import json
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store
from paper_study_for_tests import ORIGIN

from simulation.errors import InputError
from studies.cli import main
from studies.paper.fig6_shown import shown
from studies.paper.fig6_sizes import SizeTrials, Trial, Tuning, read_trials
from studies.paper.size_files import write_sizes
from studies.report.wording import count, percent, setting, significant
from studies.search_space import SearchParameter
from studies.tuning.results import importances

SEARCH: dict[str, dict[str, Any]] = {
    "n_latent": {"kind": "int", "low": 8, "high": 256, "log": True},
    "n_hidden": {"kind": "int", "low": 64, "high": 512, "log": True},
}
REPOSITORY = Path(__file__).resolve().parents[2]
COMMITTED = REPOSITORY / "data" / "paper-results" / "fig6"
Draw = Callable[..., tuple[int, dict[str, Any]]]


def trial(number: int, mae: float, n_latent: int, *, state: Any = "complete") -> Trial:
    test = mae if state == "complete" else None
    return Trial(
        number=number,
        state=state,
        proposed_by="TPESampler" if number else "default",
        params={"n_latent": n_latent, "n_hidden": 64 + 8 * number},
        val_mae=None if state == "failed" else mae,
        val_p90=None if test is None else 2.0 * mae,
        test_mae=test,
        test_p90=None if test is None else 2.0 * mae,
        n_epochs=600,
        best_epoch=600,
        wall_s=1.0,
    )


def size(n_train: int, *errors: float, pca_gp: float = 0.1, faithful: float | None = None) -> SizeTrials:
    def tuning(surrogate: str, *trials: Trial) -> Tuning:
        settings = {"n_latent": 32, "n_hidden": 256, "beta": 10.0, "learning_rate": 7e-3}
        return Tuning(surrogate, f"office/n{n_train}", len(trials), settings, SEARCH, {}, {}, trials)

    trials = [trial(number, mae, 8 << number) for number, mae in enumerate(errors)]
    more = (trial(8, 3.0, 8, state="pruned"), trial(9, 0.0, 8, state="failed"))
    return SizeTrials(
        n_train,
        2.6,
        tuning("refined", *trials, *more),
        None if faithful is None else tuning("paper", trial(0, faithful, 64)),
        tuning("pca-gp", trial(0, pca_gp, 256)),
    )


@pytest.fixture
def draw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Draw:
    """Run `studies reproduce-paper office-recorded --only fig6` in a project without the recording."""
    (tmp_path / "studies.toml").write_text("schema = 1\n")
    give_store(tmp_path)
    monkeypatch.setenv("STUDIES_ROOT", str(tmp_path))
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> tuple[int, dict[str, Any]]:
        said = io.StringIO()
        with redirect_stdout(said):
            code = main(["reproduce-paper", "office-recorded", "--only", "fig6", "--json", "--quiet", *words])
        return code, json.loads(said.getvalue())

    return run


def test_it_is_drawn_without_simulations_and_trainings(tmp_path: Path, draw: Draw) -> None:
    write_sizes(tmp_path / "trials", ORIGIN, [size(32, 1.2, 1.0, faithful=1.4), size(1024, 0.1, 0.08, 0.2)])
    code, document = draw("--from", "trials")
    assert (code, document["agreement"]) == (0, "agrees")
    folder = tmp_path / "mlruns" / "results" / "office-recorded-thorough" / "paper" / "fig6"
    result = json.loads((folder / "result.json").read_text())
    assert [picture["file"] for picture in result["pictures"]] == [
        "mae-over-n.png",
        "latent.png",
        "hidden.png",
    ]
    for picture in result["pictures"]:
        assert (folder / picture["file"]).read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "data").exists()
    assert not (tmp_path / "mlruns" / "optuna.db").exists()
    best = result["numbers"]["by_size"]["1024"]
    assert (best["best_trial"], best["best_mae"], best["n_latent"], best["n_pruned"]) == (1, 0.08, 16, 1)
    assert best["gain"] == pytest.approx(0.2)
    assert best["ratio_to_pca_gp"] == pytest.approx(0.8)
    assert "1.0 K against 2.0 K at n = 32 and 0.080 K against 0.10 K at n = 1,024" in result["verdict"]
    assert "The faithful form, with 1 trial per size, reaches 1.4 K at n = 32." in result["verdict"]


def test_the_plain_command_draws_the_committed_trials_until_one_is_made_here(
    tmp_path: Path, draw: Draw
) -> None:
    write_sizes(tmp_path / "data" / "paper-results" / "fig6", ORIGIN, [size(1024, 0.1, 0.08)])
    code, document = draw()
    assert (code, document["agreement"]) == (0, "agrees")
    # Whoever names a budget, or has made the figure here, means that it is to be made: the recording lacks.
    assert "recording" in draw("--budget", "small")[1]["error"]
    made = tmp_path / "mlruns" / "results" / ORIGIN.label / "paper" / "fig6.json"
    made.write_text("{}")
    assert "recording" in draw()[1]["error"]


def test_the_committed_trials_are_drawn_and_the_documentation_has_their_numbers(draw: Draw) -> None:
    code, _ = draw("--from", str(COMMITTED))
    assert code == 0
    origin, sizes = read_trials(COMMITTED)
    documentation = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")
    for n, numbers in shown(origin, sizes).numbers["by_size"].items():
        assert documented_row(n, numbers) in documentation


def documented_row(n: int, numbers: Mapping[str, Any]) -> str:
    """Return a row of the table in docs/paper.md."""
    cells = [
        count(n),
        f"{numbers['trials']} ({numbers['n_pruned']})",
        f"{significant(numbers['best_mae'])} ({significant(numbers['best_p90'])})",
        *(setting(numbers[name]) for name in ("n_latent", "n_hidden", "beta", "learning_rate")),
        significant(numbers["default_mae"]),
        percent(-numbers["gain"]),
        significant(numbers["pca_gp_mae"]) if "pca_gp_mae" in numbers else "",
        f"{numbers['ratio_to_pca_gp']:.2f}" if "pca_gp_mae" in numbers else "",
        {32: "2.0", 256: "0.4 to 1.1", 1024: "0.10", 4096: "0.07"}.get(n, ""),
    ]
    return f"| {' | '.join(cells)} |"


def test_files_are_read_as_they_were_written(tmp_path: Path) -> None:
    sizes = (size(32, 1.2, 1.0, faithful=1.4), size(1024, 0.1, 0.08))
    write_sizes(tmp_path, ORIGIN, sizes)
    assert read_trials(tmp_path) == (ORIGIN, sizes)


def test_errors_above_the_papers_differ() -> None:
    assert shown(ORIGIN, [size(1024, 0.2)]).agreement == "differs"
    assert shown(ORIGIN, [size(32, 1.2), size(1024, 0.2)]).agreement == "agrees in part"
    assert shown(ORIGIN, [size(64, 1.2)]).agreement == "beyond the paper"


def test_files_that_do_not_belong_together_are_refused(tmp_path: Path, draw: Draw) -> None:
    folder = tmp_path / "trials"
    assert draw("--from", "trials")[1]["error"].startswith("trials holds no trials of Fig. 6")
    write_sizes(folder, ORIGIN, [size(32, 1.2)])
    assert "remove --again" in draw("--from", "trials", "--again")[1]["error"]
    write_sizes(folder, replace(ORIGIN, seed=1), [size(64, 1.2)])
    with pytest.raises(InputError, match=r"n0064.json belongs to other studies than n0032.json"):
        read_trials(folder)
    (folder / "n0064.json").write_text('{"schema": 1}')
    with pytest.raises(InputError, match=r"n0064.json holds no trials of Fig. 6"):
        read_trials(folder)


def test_what_decides_the_order_is_most_important() -> None:
    space = {name: SearchParameter(**one) for name, one in SEARCH.items()}
    points = [{"n_latent": 8 + 4 * i, "n_hidden": 64 + (173 * i) % 448} for i in range(40)]
    found = importances(points, [float(point["n_latent"]) for point in points], space)
    assert list(found) == ["n_latent", "n_hidden"]
    assert sum(found.values()) == pytest.approx(1.0)
    assert importances(points[:3], [1.0, 2.0, 3.0], space) == {}
