"""What a person sees who opens MLflow on a finished project: the leaderboard, a study, its pictures."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from studies.paths import ProjectPaths
from studies.tracking.ui_address import ALL, leaderboard_page
from studies.tuning.trial_record import TrialRecord, best_record
from studies.tuning.trial_store import list_studies, open_trials

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SHOTS = os.environ.get("STUDIES_SCREENSHOTS")
SLOW_MS = 90_000


@pytest.fixture
def page(browser: "Browser") -> "Iterator[Page]":
    opened = browser.new_page(viewport={"width": 1600, "height": 1000})
    opened.set_default_timeout(SLOW_MS)
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def best(project: Path) -> dict[int, TrialRecord]:
    """The best trial of each size, as its record says."""
    paths = ProjectPaths(project)
    found = {
        entry.n_train: best_record(open_trials(paths, entry.name).records()) for entry in list_studies(paths)
    }
    return {n: record for n, record in found.items() if record is not None}


def test_first_screen_is_the_leaderboard_with_the_best_of_each_size(
    page: "Page", page_address: str, best: dict[int, TrialRecord]
) -> None:
    page.goto(page_address)
    cells = page.get_by_role("gridcell")
    for n_train, record in best.items():
        cells.filter(has_text=f"n{n_train:04d} study").first.wait_for()
        for metric in ("test/mae", "test/p90"):
            shown = float(f"{record.metrics[metric]:.4g}")
            cells.get_by_text(f"{shown:g}", exact=True).first.wait_for()
    shot(page, "leaderboard")
    page.get_by_text("Best test error [K] for n = 16").first.wait_for()
    assert cells.filter(has_text="trial 0").count() == 0, "trials are not on the first screen"
    assert not page.get_by_text("MLflow Assistant").is_visible()
    for column in ("best/test/mae", "default/test/mae", "gain_percent", "tuning_h", "calibrated/mse"):
        assert page.get_by_role("columnheader", name=column).count() > 0


def test_experiment_shows_the_picture_of_all_trials_over_n(page: "Page", page_address: str) -> None:
    page.goto(page_address)
    assert_is_drawn(page, "img[src*='mae_over_n.png']")


def test_study_leads_to_its_best_trial_and_its_pictures(
    page: "Page", page_address: str, best: dict[int, TrialRecord]
) -> None:
    n_train = max(best)
    page.goto(page_address)
    page.get_by_role("link", name=f"n{n_train:04d} study").first.click()
    page.get_by_text(f"Trial {best[n_train].index} is best").first.wait_for()
    page.get_by_role("link", name=f"n{n_train:04d} trial {best[n_train].index:03d}").first.wait_for()
    shot(page, "study")
    picture = page.get_by_role("link", name="learning curves").first.get_attribute("href")
    page.goto(f"{page_address.partition('#')[0]}{picture}")
    page.get_by_text("figures/learning_curves.png").first.wait_for()
    assert_is_drawn(page, "img")
    shot(page, "picture")


def test_champion_is_in_the_registry_under_its_alias(
    page: "Page", page_address: str, best: dict[int, TrialRecord]
) -> None:
    model = f"office-small-n{max(best):04d}"
    page.goto(f"{page_address.partition('#')[0]}#/models/{model}?workflowType=machine_learning")
    page.get_by_text("champion").first.wait_for()
    shot(page, "registry")


def assert_is_drawn(page: "Page", selector: str) -> None:
    """Fail unless the browser has loaded a picture: it is wider than the sign of a broken one."""
    page.wait_for_function(
        "selector => [...document.querySelectorAll(selector)].some(p => p.complete && p.naturalWidth > 300)",
        arg=selector,
    )


def shot(page: "Page", name: str) -> None:
    if SHOTS:
        page.screenshot(path=Path(SHOTS) / f"test_{name}.png")


def test_address_is_that_of_the_label_asked_for(page_address: str) -> None:
    server = page_address.partition("#")[0].replace("studies.localhost", "127.0.0.1")
    assert leaderboard_page(server, label="office-small") == page_address.removeprefix(
        page_address.partition("#")[0]
    )
    assert leaderboard_page(server, label="office-smal") == ALL
    assert leaderboard_page("http://127.0.0.1:1/", label=None) == ALL, "nobody answers there"
