"""What a person sees who opens the addresses that `studies ui` prints: runs, best trials, curves, models."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from studies.paths import ProjectPaths
from studies.tuning.results import TunedStudy, read_studies

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SHOTS = os.environ.get("STUDIES_SCREENSHOTS")
SLOW_MS = 90_000
ALL = "All runs of office-small"
BEST = "Best trial per training-set size of office-small"
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
    found = [one for one in read_studies(ProjectPaths(project)) if not one.spec.is_baseline]
    assert [one.spec.n_train for one in found] == [16, 24]
    return found


def shot(page: "Page", name: str) -> None:
    if SHOTS:
        page.screenshot(path=Path(SHOTS) / f"test_{name}.png")


def test_three_addresses_of_this_machine_are_printed(addresses: dict[str, str]) -> None:
    assert set(addresses) == {ALL, BEST, MODELS}
    assert all(address.startswith("http://127.0.0.1:") for address in addresses.values())


def test_runs(page: "Page", addresses: dict[str, str], tuned: list[TunedStudy]) -> None:
    for name, what in (("all", ALL), ("best", BEST), ("models", MODELS)):
        page.goto(addresses[what])
        page.wait_for_timeout(8000)
        shot(page, name)
    server = addresses[ALL].partition("#")[0]
    best = tuned[0].best
    page.goto(f"{addresses[ALL].partition('/runs')[0]}/runs/{best.run_id}")
    page.wait_for_timeout(8000); shot(page, "run")
    page.goto(f"{addresses[ALL].partition('/runs')[0]}/runs/{best.run_id}/model-metrics")
    page.wait_for_timeout(8000); shot(page, "metrics")
    page.goto(f"{server}#/models/office-small-n0016")
    page.wait_for_timeout(8000); shot(page, "model")
    page.goto(f"{addresses[ALL].partition('/runs')[0]}/models")
    page.wait_for_timeout(8000); shot(page, "logged")
