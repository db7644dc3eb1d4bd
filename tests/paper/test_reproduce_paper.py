"""`studies reproduce-paper` from end to end with a toy profile: files, ledger, resuming."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mlflow
import pytest
from paper_study_for_tests import COMMITTED

from studies.paper import ITEMS
from studies.paper.fig6 import SizeTrials
from studies.paper.items import module_of, read_sizes, size_files
from studies.paper.table4 import SizeCalibrations
from studies.paths import ProjectPaths
from studies.tuning.study_results import read_studies

pytestmark = pytest.mark.slow

Reproduce = Callable[..., tuple[int, dict[str, Any]]]
RESULTS = Path("mlruns") / "results" / "office-toy" / "paper"
WORDS = ("--seeds", "2")


def result_of(project: Path, item: str) -> dict[str, Any]:
    content = json.loads((project / RESULTS / item / "result.json").read_text())
    assert isinstance(content, dict)
    return content


def test_a_dry_run_says_what_is_made_and_writes_nothing(project: Path, reproduce: Reproduce) -> None:
    before = sorted(project.rglob("*"))
    code, document = reproduce("--dry-run")
    assert (code, document["items"]) == (0, list(ITEMS))
    # Table 4 trains the best of Fig. 6 again, unless their hyperparameters are given.
    assert reproduce("--dry-run", "--only", "fig9")[1]["items"] == ["fig6", "table4"]
    given = reproduce("--dry-run", "--only", "table4", "--hyperparameters", "nowhere")
    assert given[1]["items"] == ["table4"]
    assert sorted(project.rglob("*")) == before


@pytest.fixture(scope="module")
def made(reproduce: Reproduce) -> dict[str, Any]:
    """What the command said that made all items."""
    code, document = reproduce(*WORDS)
    assert code == 0
    return document


def test_every_item_has_a_table_each_figure_a_picture_and_is_a_run_of_mlflow(
    project: Path, made: dict[str, Any]
) -> None:
    assert list(made["items"]) == list(ITEMS)
    for item in ITEMS:
        result = result_of(project, item)
        assert (
            result["command"] == f"studies reproduce-paper office --profile toy.toml --seeds 2 --only {item}"
        )
        assert result["table"]
        pictures = list((project / RESULTS / item).glob("*.png"))
        assert len(pictures) == (item != "table3")
        assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    mlflow.set_tracking_uri(ProjectPaths(project).tracking_uri)
    runs: Any = mlflow.search_runs(experiment_names=["office-toy"], filter_string="tags.role = 'paper'")
    assert set(runs["params.item"]) == set(ITEMS)


@pytest.mark.usefixtures("made")
def test_what_is_finished_is_not_computed_again(project: Path, reproduce: Reproduce) -> None:
    before = {file: file.read_bytes() for file in (project / RESULTS).rglob("*.json")}
    rows = [*(project / RESULTS / "table3").glob("*.json"), *(project / RESULTS / "fig8").glob("*.json")]
    written = {file: file.stat().st_mtime_ns for file in rows if file.name != "result.json"}
    assert len(written) >= 4
    assert reproduce(*WORDS)[0] == 0
    assert {file: file.read_bytes() for file in before} == before
    assert {file: file.stat().st_mtime_ns for file in written} == written


@pytest.mark.usefixtures("made")
@pytest.mark.parametrize("item", ["fig6", "fig7", "table4"])
def test_an_item_is_drawn_again_from_its_files(project: Path, item: str) -> None:
    module = module_of(item)
    again = module.shown(*read_sizes(project / RESULTS / item, module.SIZE))
    table = [dict(zip(again.columns, row, strict=True)) for row in again.rows]
    assert table == result_of(project, item)["table"]


@pytest.mark.usefixtures("made")
def test_a_spread_of_one_is_the_test_set_and_one_of_zero_a_single_point(project: Path) -> None:
    (content,) = (json.loads(file.read_text()) for file in size_files(project / RESULTS / "fig7"))
    size, n_rows = content["size"], 12
    # At spread 1 nothing is restricted: both kinds are the test set that trials are judged by.
    assert size["mae"]["important"][-1] == size["mae"]["all"][-1]
    (tuned,) = read_studies(ProjectPaths(project), label="office-toy-fig6")
    assert tuned.best is not None
    assert size["mae"]["all"][-1] == pytest.approx(tuned.best.metrics["test/mae"], rel=1e-6)
    # At spread 0 all rows are one, so the 90th percentile is the mean.
    assert size["p90"]["all"][0] == pytest.approx(size["mae"]["all"][0], rel=1e-6)
    # Ten spreads of each kind below 1, one point for spread 0 of all.
    assert size["n_rows"] == 10 * n_rows + 9 * n_rows + 1
    assert len(size["important"]) == 6


@pytest.mark.usefixtures("made")
def test_the_ledger_of_table_4_adds_up_and_the_best_of_fig_6_is_trained_again(project: Path) -> None:
    _, (size,) = read_sizes(project / RESULTS / "table4", SizeCalibrations)
    assert size.n_train == 16
    assert [one.seed for one in size.calibrations] == [0, 1]
    for one in size.calibrations:
        assert 1 <= one.n_checks <= 5
        assert one.n_polish <= 16
        assert one.polish_calls[-1] == one.n_calls
        assert one.polish_mse[-1] == pytest.approx(one.mse_polished)
    _, (trials,) = read_sizes(project / RESULTS / "fig6", SizeTrials)
    (tuned,) = read_studies(ProjectPaths(project), label="office-toy-fig6")
    assert size.settings == trials.networks.best.params == tuned.trials[0].params
    assert tuned.best is not None
    assert size.calibrations[0].test_mae == tuned.best.metrics["test/mae"]


def test_hyperparameters_that_do_not_fit_are_refused(reproduce: Reproduce) -> None:
    code, document = reproduce("--only", "table4", "--hyperparameters", "nowhere")
    assert (code, "nowhere holds no results of this item" in document["error"]) == (2, True)
    code, document = reproduce("--only", "table4", "--hyperparameters", str(COMMITTED / "fig6"))
    assert (code, "holds no trials of n_train = 16" in document["error"]) == (2, True)
