"""A project with a finished smoke run, its interface in a server of its own, and a real browser."""

import os
import re
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

REPOSITORY = Path(__file__).resolve().parents[2]
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)


def studies(root: Path, *words: str) -> "subprocess.Popen[str]":
    """Start a command of ours on a project."""
    return subprocess.Popen(
        [sys.executable, "-m", "studies", *words],
        env=os.environ | {"STUDIES_ROOT": str(root)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with the studies of the smoke profile and a calibration."""
    root = tmp_path_factory.mktemp("browser") / "project"
    (root / "fmus" / "office").mkdir(parents=True)
    for name in ("Office.fmu", "case.toml"):
        shutil.copy(REPOSITORY / "fmus" / "office" / name, root / "fmus" / "office" / name)
    shutil.copytree(
        REPOSITORY / "data" / "office", root / "data" / "office", ignore=shutil.ignore_patterns("generated")
    )
    (root / "pyproject.toml").write_text("", encoding="utf-8")
    for words in (("tune",), ("calibrate", "--n-train", "32")):
        done = studies(root, *words, "--profile", "smoke", "--quiet")
        out, err = done.communicate(timeout=300)
        assert done.returncode == 0, out + err
    return root


@pytest.fixture(scope="module")
def page_address(project: Path) -> Iterator[str]:
    """The address that `studies ui` prints; the server ends with the module."""
    server = studies(project, "ui")
    try:
        assert server.stdout is not None
        found = re.search(r"http://\S+", server.stdout.readline())
        assert found is not None, server.stderr.read() if server.stderr else ""
        yield found.group()
    finally:
        server.send_signal(signal.SIGTERM)
        server.communicate(timeout=30)
    assert server.returncode == 0


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """Chromium without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM:
        pytest.skip("there is no Chromium on this machine (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()
