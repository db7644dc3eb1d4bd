"""`studies reproduce-paper` from end to end with a toy profile: files, page, ledger, resuming, honesty."""

import csv
import html
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from simulation.case import load_case
from studies.paper.catalog import DRAWN, ITEMS
from studies.paper.fig6_sizes import read_trials
from studies.paper.fig7 import SPREADS
from studies.paper.table4_shown import known
from studies.paper.table4_sizes import read_calibrations
from studies.paths import ProjectPaths
from studies.tuning.results import read_studies

Reproduce = Callable[..., tuple[int, dict[str, Any]]]
MADE = ("fig5", "fig6", "fig7", "table3", "fig8", "table4")
RESULTS = Path("mlruns") / "results" / "office-toy" / "paper"
PAGE = Path("mlruns") / "reports" / "office-toy" / "paper" / "index.html"


def result_of(project: Path, item: str) -> dict[str, Any]:
    content = json.loads((project / RESULTS / item / "result.json").read_text())
    assert isinstance(content, dict)
    return content


def test_a_dry_run_says_what_it_costs_and_writes_nothing(project: Path, reproduce: Reproduce) -> None:
    before = sorted(project.rglob("*"))
    code, document = reproduce("--dry-run")
    assert code == 0
    assert set(document["estimated_s"]) == {item.name for item in ITEMS}
    # Table 4 trains the best of Fig. 6 again, unless their hyperparameters are given.
    _, alone = reproduce("--dry-run", "--only", "table4")
    assert set(alone["estimated_s"]) == {"fig6", "table4"}
    _, given = reproduce("--dry-run", "--only", "table4", "--hyperparameters", "elsewhere")
    assert set(given["estimated_s"]) == {"table4"}
    assert sorted(project.rglob("*")) == before


@pytest.fixture(scope="module")
def made(reproduce: Reproduce) -> dict[str, Any]:
    """What the command said that made some of the items."""
    code, document = reproduce(
        "--only",
        "fig6",
        "fig7",
        "table2",
        "fig8",
        "fig9",
        "--seeds",
        "2",
        "--export",
        "out/paper.json",
    )
    assert code == 0
    return document


def test_items_are_made_with_what_they_need(made: dict[str, Any]) -> None:
    assert [stage["stage"] for stage in made["stages"]] == [f"paper/{name}" for name in MADE]
    assert not any(stage["finished_before"] for stage in made["stages"])


@pytest.mark.usefixtures("made")
def test_every_item_is_on_the_page_with_pictures_tables_and_verdict(project: Path) -> None:
    page = (project / PAGE).read_text()
    for item in ITEMS:
        section = section_of(page, item.name)
        assert ("Not there yet" in section) == (item.name not in MADE)
        assert f"studies reproduce-paper office --profile toy.toml --seeds 2 --only {item.name}<" in section
    for name in MADE:
        result, section = result_of(project, name), section_of(page, name)
        assert result["verdict"]
        assert result["verdict"] in html.unescape(section)
        assert result["command"].startswith("studies reproduce-paper office --profile toy.toml --seeds 2")
        assert result["command"].endswith(f" --only {name}")
        assert result["n_calls"]["total"] == sum(n for w, n in result["n_calls"].items() if w != "total") > 0
        assert section.count("<img ") == len(result["pictures"]) > 0
        for picture in result["pictures"]:
            assert (project / RESULTS / name / picture["file"]).read_bytes().startswith(b"\x89PNG")
        for table in result["tables"]:
            with (project / RESULTS / name / f"{table['name']}.csv").open(newline="") as file:
                assert len(list(csv.reader(file))) == 1 + len(table["rows"])


@pytest.mark.usefixtures("made")
def test_finished_items_are_not_made_again(reproduce: Reproduce) -> None:
    code, document = reproduce("--only", *MADE, "--seeds", "2")
    assert code == 0
    assert all(stage["finished_before"] for stage in document["stages"])
    assert not any(document["estimated_s"].values())


@pytest.mark.usefixtures("made")
def test_the_export_holds_the_items_that_are_there_and_is_small(project: Path) -> None:
    exported = json.loads((project / "out" / "paper.json").read_text())
    assert list(exported["items"]) == list(MADE)
    assert (project / "out" / "paper.json").stat().st_size < 100_000


def section_of(page: str, item: str) -> str:
    return page.split(f'<section id="{item}">', 1)[1].split("</section>", 1)[0]


@pytest.mark.usefixtures("made")
@pytest.mark.parametrize("item", DRAWN)
def test_an_item_is_drawn_again_from_its_files(project: Path, reproduce: Reproduce, item: str) -> None:
    made = result_of(project, item)
    code, _ = reproduce("--only", item, "--from", str(project / RESULTS / item))
    assert code == 0
    again = result_of(project, item)
    for part in ("verdict", "numbers", "tables", "pictures", "metrics", "n_calls", "seeds", "settings"):
        assert again[part] == made[part]


@pytest.mark.usefixtures("made")
def test_a_spread_of_one_is_the_test_set_and_one_of_zero_a_single_point(project: Path) -> None:
    result = result_of(project, "fig7")
    numbers, n_rows = result["numbers"], 12
    for n in ("16",):
        important, everything = numbers["mae"]["important"][n], numbers["mae"]["all"][n]
        assert len(everything) == len(SPREADS) == 11
        # At spread 1 nothing is restricted: both kinds are the test set that trials are judged by.
        assert important[-1] == everything[-1]
        (tuned,) = read_studies(ProjectPaths(project), label="office-toy-fig6")
        assert tuned.best is not None
        assert everything[-1] == pytest.approx(tuned.best.metrics["test/mae"], rel=1e-6)
        # At spread 0 all rows are one, so the 90th percentile is the mean.
        assert numbers["p90"]["all"][n][0] == pytest.approx(everything[0], rel=1e-6)
    # Ten spreads of each kind below 1, one point for spread 0 of all; the test set itself is another item.
    assert result["n_calls"]["narrower test sets"] == 10 * n_rows + 9 * n_rows + 1
    assert result["n_calls"]["test set"] == n_rows


@pytest.mark.usefixtures("made")
def test_the_ledger_of_table_4_adds_up(project: Path) -> None:
    result = result_of(project, "table4")
    _, (size,) = read_calibrations(project / RESULTS / "table4")
    assert size.n_train == 16
    assert [one.seed for one in size.calibrations] == [0, 1]
    for one in size.calibrations:
        assert 1 <= one.n_checks <= 5
        assert one.n_polish <= 16
        assert one.polish_calls[-1] == one.n_checks + one.n_polish
        assert one.polish_mse[-1] == pytest.approx(one.mse_polished)
        assert known(one.mse_polished) <= known(one.mse_screened)
    row = result["numbers"]["by_size"]["16"]
    assert row["median"]["total_honest"] == row["median"]["total_paper"] + 8 + 12
    calls = result["n_calls"]
    assert calls["polish"] == sum(one.n_polish for one in size.calibrations)
    assert (calls["training sets"], calls["validation and test sets"]) == (2 * 16, 8 + 12)


@pytest.mark.usefixtures("made")
def test_table_4_trains_the_best_of_fig_6_again(project: Path) -> None:
    _, (trials,) = read_trials(project / RESULTS / "fig6")
    _, (size,) = read_calibrations(project / RESULTS / "table4")
    assert size.settings == trials.networks.best.params
    (tuned,) = read_studies(ProjectPaths(project), label="office-toy-fig6")
    assert [trial.params for trial in tuned.trials] == [size.settings]
    assert tuned.best is not None
    assert size.calibrations[0].test_mae == tuned.best.metrics["test/mae"]


def test_hyperparameters_that_do_not_fit_are_refused(reproduce: Reproduce) -> None:
    code, document = reproduce("--only", "table4", "--hyperparameters", "elsewhere")
    assert (code, "elsewhere holds no trials of Fig. 6" in document["error"]) == (2, True)
    committed = Path(__file__).resolve().parents[2] / "data" / "paper-results" / "fig6"
    code, document = reproduce("--only", "table4", "--hyperparameters", str(committed))
    assert (code, "holds no trials of n_train = 16" in document["error"]) == (2, True)


@pytest.mark.usefixtures("made")
def test_nothing_of_the_measurement_is_exported(project: Path) -> None:
    case = load_case(project / "fmus" / "office" / "case.toml")
    measured = {round(float(value), 4) for value in case.measurement.y.ravel()}
    assert len(measured) > 100

    def numbers_in(value: Any) -> set[float]:
        if isinstance(value, dict):
            return set().union(*map(numbers_in, value.values())) if value else set()
        if isinstance(value, list):
            return set().union(*map(numbers_in, value)) if value else set()
        return {round(value, 4)} if isinstance(value, float) else set()

    exported = numbers_in(json.loads((project / "out" / "paper.json").read_text()))
    assert len(exported & measured) <= 2  # an index or an error may coincide with a temperature


def test_unknown_words_are_one_line(reproduce: Reproduce) -> None:
    code, document = reproduce("--only", "fig1")
    assert (code, "no such item" in document["error"]) == (2, True)
    code, document = reproduce("--row", "powell")
    assert (code, document["error"].startswith("--row powell: there is no such row")) == (2, True)


@pytest.mark.parametrize(
    ("words", "refused"),
    [
        (["--dry-run"], "remove --dry-run"),
        (["--only", "fig5"], "remove --only fig5"),
        (["--only", "table2", "fig5", "--again"], "remove --only table2 fig5 and --again"),
        (["--only", "table3", "--export", "out.json"], "remove --export"),
    ],
)
def test_a_row_alone_is_refused_beside_what_it_would_ignore(
    reproduce: Reproduce, words: list[str], refused: str
) -> None:
    code, document = reproduce("--row", "powell-scalar-physical-seed0-001", *words)
    assert (code, document["error"]) == (2, f"--row computes one row of table3 and nothing else; {refused}")


def test_a_dry_run_exports_nothing(reproduce: Reproduce) -> None:
    code, document = reproduce("--dry-run", "--export", "out.json")
    assert (code, "remove one of them" in document["error"]) == (2, True)
