"""Figures and tables drawn from the files of an earlier run: no recording, no simulation, no training."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store
from paper_study_for_tests import COMMITTED, REPOSITORY, reproduce_paper

from simulation.errors import InputError
from studies.paper.fig6 import SizeTrials, shown
from studies.paper.items import read_sizes, write_size
from studies.words.wording import count, percent, setting, significant

Draw = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture
def draw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Draw:
    """Run `studies reproduce-paper office-recorded` in a project without the recording."""
    (tmp_path / "studies.toml").write_text("schema = 1\n")
    give_store(tmp_path)
    monkeypatch.chdir(tmp_path)
    return partial(reproduce_paper, "office-recorded")


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
    origin, (first, second, *_) = read_sizes(COMMITTED / "fig6", SizeTrials)
    write_size(tmp_path, origin, 32, first)
    assert "remove --dry-run" in draw(*words, "--dry-run")[1]["error"]
    assert "draws one item alone" in draw("--from", "trials")[1]["error"]
    write_size(tmp_path, replace(origin, seed=1), 64, second)
    with pytest.raises(InputError, match=r"n0064.json belongs to other studies than the smallest size"):
        read_sizes(tmp_path, SizeTrials)
    (tmp_path / "n0064.json").write_text('{"schema": 1}')
    with pytest.raises(InputError, match=r"n0064.json: .* use the version that wrote it"):
        read_sizes(tmp_path, SizeTrials)
