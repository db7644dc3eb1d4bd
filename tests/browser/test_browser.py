"""What a person sees who opens the addresses that `studies ui` prints: runs, best trials, curves, models."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from studies.paths import ProjectPaths
from studies.results.best_mean import shortened_model
from studies.results.trials import TunedStudy
from studies.tuning.study_results import read_studies
from studies.words.wording import setting, significant

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SLOW_MS = 90_000
ALL = "All runs of office-smoke"
BEST = "Leaderboard of office-smoke, the best trial per training-set size"
CHARTS = "Charts of office-smoke, every trial"
MODELS = "Registered models"


@pytest.fixture
def page(browser: "Browser") -> "Iterator[Page]":
    opened = browser.new_page(viewport={"width": 1600, "height": 1000})
    opened.set_default_timeout(SLOW_MS)
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def tuned(project: Path) -> list[TunedStudy]:
    """The study of each size, as Optuna has it."""
    every = read_studies(ProjectPaths(project))
    found = [one for one in every if not one.spec.is_baseline]
    # A baseline stands beside each, which the page of the best must not show.
    assert [one.spec.n_train for one in every if one.spec.is_baseline and one.best] == [16, 32]
    assert [one.spec.n_train for one in found] == [16, 32]
    return found


def test_four_addresses_of_this_machine_are_printed(addresses: dict[str, str]) -> None:
    assert list(addresses) == [BEST, CHARTS, ALL, MODELS]
    assert all(address.startswith("http://127.0.0.1:") for address in addresses.values())


def test_the_first_screen_names_the_best_of_each_size_above_the_runs(
    page: "Page", addresses: dict[str, str], tuned: list[TunedStudy]
) -> None:
    page.goto(addresses[ALL])
    cells = page.get_by_role("gridcell")
    for name in ("n0016 study", "n0032 study", "n0032 calibration"):
        cells.filter(has_text=name).first.wait_for()
    note = page.get_by_text("Best per n_train (n_latent / n_hidden / beta").first
    note.wait_for()
    for study in tuned:
        assert study.best is not None
        chosen = [study.best.params.get(name) for name in ("n_latent", "n_hidden", "beta")]
        errors = [study.best.metrics[name] for name in ("test/mae", "test/p90")]
        mean = f"{shortened_model(study.best.model)}, " if study.best.parts else ""
        said = f"{mean}{' / '.join(map(setting, chosen))} → {', '.join(map(significant, errors))}"
        assert f"{study.spec.n_train}: {said}" in note.inner_text()


def test_the_best_trials_are_filtered_from_the_others(
    page: "Page", addresses: dict[str, str], tuned: list[TunedStudy]
) -> None:
    page.goto(addresses[BEST])
    cells = page.get_by_role("gridcell")
    for study in tuned:
        assert study.best is not None
        which = "mean" if study.best.parts else f"trial {study.best.number:03d}"
        cells.filter(has_text=f"n{study.spec.n_train:04d} {which}").first.wait_for()
    n_trials = sum(study.best is not None and not study.best.parts for study in tuned)
    assert cells.filter(has_text=" trial 0").count() == n_trials
    assert cells.filter(has_text="PCA + GP").count() == 0
    assert cells.filter(has_text="calibration").count() == 0


def test_the_leaderboard_shows_errors_and_hyperparameters_without_a_click(
    page: "Page", addresses: dict[str, str], tuned: list[TunedStudy]
) -> None:
    page.set_viewport_size({"width": 1280, "height": 800})
    page.goto(addresses[BEST])
    page.get_by_role("gridcell").filter(has_text="n0016").first.wait_for()
    ends = [0.0]
    for name in ("test/mae", "test/p90", "n_train", "n_latent", "n_hidden", "beta", "gain"):
        title = page.locator(f".ag-header-cell[col-id$='`{name}`']")
        title.wait_for()
        box = title.bounding_box()
        assert box is not None
        assert box["x"] >= ends[-1], name
        ends.append(box["x"] + box["width"])
    # What MLflow opens beside it at the first visit covers none of them.
    assistant = page.get_by_text("MLflow Assistant").first.bounding_box()
    assert assistant is not None
    assert ends[-1] <= assistant["x"]
    for study in tuned:
        assert study.best is not None
        start = f"{study.best.metrics['test/mae']:.17g}"[:5]
        page.get_by_role("gridcell").filter(has_text=start).first.wait_for()


def test_the_charts_show_the_error_over_n_and_over_each_hyperparameter(
    page: "Page", addresses: dict[str, str]
) -> None:
    page.goto(addresses[CHARTS])
    for x in ("n_train", "n_latent", "n_hidden", "beta"):
        page.get_by_text(f"{x} vs. test/mae").first.wait_for()
    page.get_by_text("n_train vs. test/p90").first.wait_for()
    page.get_by_text("Parallel Coordinates").first.wait_for()
    page.locator(".js-plotly-plot .points path").first.wait_for()


def test_a_trial_shows_its_hyperparameters_errors_and_curves(
    page: "Page", addresses: dict[str, str], tuned: list[TunedStudy]
) -> None:
    best = tuned[0].best_trial
    assert best is not None
    run = f"{addresses[ALL].partition('/runs')[0]}/runs/{best.run_id}"
    page.goto(run)
    for word in ("n_latent", "n_hidden", "beta", "test/mae", "test/p90", "Finished"):
        page.get_by_text(word, exact=True).first.wait_for()
    for value in (best.metrics["test/mae"], best.metrics["test/p90"], best.params["n_latent"]):
        page.get_by_text(str(value), exact=True).first.wait_for()
    page.goto(f"{run}/model-metrics")
    page.get_by_text(f"n0016 trial {best.number:03d} (curve/validation_mae)").first.wait_for()


def test_the_best_model_is_in_the_registry_under_its_alias(page: "Page", addresses: dict[str, str]) -> None:
    page.goto(addresses[MODELS])
    page.get_by_role("link", name="office-smoke-n0016").first.wait_for()
    page.get_by_role("link", name="office-smoke-n0032").first.wait_for()
    page.goto(addresses[MODELS].replace("#/models", "#/models/office-smoke-n0032"))
    page.get_by_text("champion").first.wait_for()
