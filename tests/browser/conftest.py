"""The interface of a finished project in a server of its own, and a real browser."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
STOP_LIMIT_S = 60.0


@pytest.fixture(scope="module", autouse=True)
def needs_a_browser() -> None:
    """Skip before anything is made where nothing could look at it."""
    if importlib.util.find_spec("playwright") is None:
        pytest.skip("playwright is not installed (pip install playwright)")
    if not CHROMIUM:
        pytest.skip("there is no Chromium on this machine (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def project(needs_a_browser: None, whole_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project of the whole run, copied: a server writes into it."""
    return shutil.copytree(whole_run, tmp_path_factory.mktemp("browser") / "project")


@pytest.fixture(scope="module")
def addresses(project: Path) -> Iterator[dict[str, str]]:
    """The addresses that `studies ui` prints, by what it says of each; the server ends with the module."""
    server = subprocess.Popen(
        [sys.executable, "-u", "-m", "studies", "ui"],
        env=os.environ | {"STUDIES_ROOT": str(project)},
        cwd=project,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    said: dict[str, str] = {}
    try:
        assert server.stdout is not None
        for line in server.stdout:
            what, separator, address = line.rstrip().partition(": ")
            if not separator:
                break
            said[what] = address
        yield said
    finally:
        server.send_signal(signal.SIGTERM)
        _, errors = server.communicate(timeout=STOP_LIMIT_S)
    assert server.returncode == 0, errors


@pytest.fixture(scope="module")
def browser(needs_a_browser: None) -> "Iterator[Browser]":
    """Chromium without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()
