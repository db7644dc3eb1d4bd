"""Figures and tables drawn from the files of an earlier run: no recording, no simulation, no training."""

import io
import json
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store
from paper_study_for_tests import COMMITTED, ORIGIN, REPOSITORY

from simulation.errors import InputError
from studies.cli import main
from studies.paper.fig6 import SizeTrials, Trial, Tuning, shown
from studies.paper.items import read_sizes, write_size
from studies.report.wording import count, percent, setting, significant

SEARCH: dict[str, dict[str, Any]] = {
    "n_latent": {"kind": "int", "low": 8, "high": 256, "log": True},
    "n_hidden": {"kind": "int", "low": 64, "high": 512, "log": True},
}
Draw = Callable[..., tuple[int, dict[str, Any]]]


def trial(number: int, mae: float, n_latent: int, *, state: str = "complete") -> Trial:
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


def size(n_train: int, *errors: float) -> SizeTrials:
    def tuning(surrogate: str, *trials: Trial) -> Tuning:
        settings = {"n_latent": 32, "n_hidden": 256, "beta": 10.0, "learning_rate": 7e-3}
        return Tuning(surrogate, f"office/n{n_train}", len(trials), settings, SEARCH, {}, {}, trials)

    trials = [trial(number, mae, 8 << number) for number, mae in enumerate(errors)]
    more = (trial(8, 3.0, 8, state="pruned"), trial(9, 0.0, 8, state="failed"))
    networks, pca_gp = tuning("refined", *trials, *more), tuning("pca-gp", trial(0, 0.1, 256))
    return SizeTrials(n_train, 2.6, networks, tuning("paper", trial(0, 1.4, 64)), pca_gp)


@pytest.fixture
def draw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Draw:
    """Run `studies reproduce-paper office-recorded` in a project without the recording."""
    (tmp_path / "studies.toml").write_text("schema = 1\n")
    give_store(tmp_path)
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> tuple[int, dict[str, Any]]:
        said = io.StringIO()
        with redirect_stdout(said):
            code = main(["reproduce-paper", "office-recorded", "--json", "--quiet", *words])
        return code, json.loads(said.getvalue())

    return run


@pytest.mark.parametrize(
    ("item", "picture"), [("fig6", "mae-over-n.png"), ("fig7", "spread.png"), ("table4", "fig9.png")]
)
def test_the_committed_files_are_drawn(tmp_path: Path, draw: Draw, item: str, picture: str) -> None:
    code, document = draw("--only", item, "--from", str(COMMITTED / item))
    assert code == 0
    numbers, drawn = (tmp_path / file for file in document["files"])
    assert drawn.name == picture
    assert drawn.read_bytes().startswith(b"\x89PNG")
    assert [row["n_train"] for row in json.loads(numbers.read_text())["table"]][:2] == [32, 64]
    assert not (tmp_path / "mlruns" / "optuna.db").exists()


def test_the_best_is_chosen_by_validation_beside_default_and_others() -> None:
    result = shown(ORIGIN, [size(1024, 0.1, 0.08, 0.2)])
    row = dict(zip(result.columns, result.rows[0], strict=True))
    assert (row["MAE"], row["n_latent"], row["trials"], row["pruned"]) == (0.08, 16, 5, 1)
    assert row["gain"] == pytest.approx(0.2)
    assert (row["PCA+GP MAE"], row["faithful MAE"], row["paper MAE"]) == (0.1, 1.4, 0.1)


def test_the_committed_trials_are_what_the_documentation_says() -> None:
    result = shown(*read_sizes(COMMITTED / "fig6", SizeTrials))
    documentation = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")
    for row in result.rows:
        assert documented_row(dict(zip(result.columns, row, strict=True))) in documentation
    said = [f"{name} {percent(part)}" for name, part in result.more["importances"]["all"].items()]
    assert f"{', '.join(said[:-1])} and {said[-1]}" in documentation


def documented_row(row: Mapping[str, Any]) -> str:
    """Return a row of the table in docs/paper.md."""
    cells = [
        count(row["n_train"]),
        f"{row['trials']} ({row['pruned']})",
        f"{significant(row['MAE'])} ({significant(row['P90'])})",
        *(setting(row[name]) for name in ("n_latent", "n_hidden", "beta", "learning_rate")),
        significant(row["MAE untuned"]),
        percent(-row["gain"]),
        significant(row["PCA+GP MAE"]),
        f"{row['MAE'] / row['PCA+GP MAE']:.2f}",
        {32: "2.0", 256: "0.4 to 1.1", 1024: "0.10", 4096: "0.07"}.get(row["n_train"], ""),
    ]
    return f"| {' | '.join(cells)} |"


def test_files_that_do_not_belong_together_are_refused(tmp_path: Path, draw: Draw) -> None:
    words = ("--only", "fig6", "--from", str(tmp_path))
    assert "holds no results of this item" in draw(*words)[1]["error"]
    write_size(tmp_path, ORIGIN, 32, size(32, 1.2))
    assert "remove --dry-run" in draw(*words, "--dry-run")[1]["error"]
    assert "draws one item alone" in draw("--from", "trials")[1]["error"]
    write_size(tmp_path, replace(ORIGIN, seed=1), 64, size(64, 1.2))
    with pytest.raises(InputError, match=r"n0064.json belongs to other studies than the smallest size"):
        read_sizes(tmp_path, SizeTrials)
    (tmp_path / "n0064.json").write_text('{"schema": 1}')
    with pytest.raises(InputError, match=r"n0064.json: .* use the version that wrote it"):
        read_sizes(tmp_path, SizeTrials)
