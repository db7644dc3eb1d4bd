"""What a person sees who opens a report: pictures that zoom and show their values, wide and narrow."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from records_for_tests import adaptive, calibration, report_data, uncertainty

from studies.reporting.page import write_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

DRAWN = """() => [...document.querySelectorAll("figure")].every(
    (figure) => !figure.clientWidth || figure.querySelector("canvas")
)"""
WIDTHS = """() => [...document.querySelectorAll("figure canvas")].map(
    (canvas) => [canvas.offsetWidth, canvas.closest(".chart").clientWidth]
)"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    calibrations = (calibration(32), calibration(64), adaptive())
    file = tmp_path_factory.mktemp("report") / "index.html"
    write_page(report_data(*calibrations, uncertainties=(uncertainty(),)), file)
    return file


@pytest.fixture(scope="module", params=[1300, 420])
def page(browser: "Browser", report: Path, request: pytest.FixtureRequest) -> "Iterator[Page]":
    """The page in a window so wide; nothing is asked of the network, and nothing is complained of."""
    opened = browser.new_page(viewport={"width": request.param, "height": 900})
    said: list[str] = []
    opened.on("console", lambda message: message.type == "error" and said.append(message.text))
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.on("request", lambda asked: said.append(asked.url) if asked.url.startswith("http") else None)
    opened.goto(report.as_uri())
    opened.wait_for_function(DRAWN)
    yield opened
    assert said == []
    opened.close()


def test_every_picture_is_drawn_as_wide_as_its_place(page: "Page") -> None:
    assert page.locator("figure canvas").count() >= 6
    widths = page.evaluate(WIDTHS)
    assert all(0.9 * place < width <= place for width, place in widths), widths
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]  # type: ignore[index]


def test_the_values_of_a_picture_are_a_csv_file(page: "Page", tmp_path: Path) -> None:
    with page.expect_download() as saved:
        page.locator("a.values").first.click()
    assert saved.value.suggested_filename.endswith(".csv")
    saved.value.save_as(tmp_path / "values.csv")
    header, *rows = (tmp_path / "values.csv").read_text("utf-8").splitlines()
    assert header.startswith("panel,series,x,y")
    assert len(rows) > 100


def test_the_value_next_to_the_pointer_is_shown(page: "Page") -> None:
    picture = page.locator("figure canvas").first
    picture.hover(position={"x": 150, "y": 120})
    tip = page.locator("#vg-tooltip-element.visible")
    tip.wait_for()
    said = tip.inner_text()
    assert "time [d]" in said
    assert "TAir" in said
    assert "measured" in said or "calibrated" in said
    assert "undefined" not in said


def test_a_wheel_with_ctrl_zooms_and_a_double_click_goes_back(page: "Page") -> None:
    canvas = page.locator("figure canvas").first
    seen = "c => c.toDataURL()"
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(0, 0)
    whole = canvas.evaluate(seen)
    page.mouse.move(box["x"] + 150, box["y"] + 120)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -400)
    page.keyboard.up("Control")
    page.mouse.move(0, 0)
    page.wait_for_timeout(500)
    assert canvas.evaluate(seen) != whole
    page.mouse.dblclick(box["x"] + 150, box["y"] + 120)
    page.mouse.move(0, 0)
    page.wait_for_timeout(500)
    assert canvas.evaluate(seen) == whole
