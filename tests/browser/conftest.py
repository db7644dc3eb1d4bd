"""A small finished project, its interface in a server of its own, and a real browser."""

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
from mlflow_store_for_tests import give_store

from studies.cli import main

if TYPE_CHECKING:
    from playwright.sync_api import Browser

REPOSITORY = Path(__file__).resolve().parents[2]
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
SMALL_PROFILE = """\
schema = 1
name = "small"
[data]
n_train = [16, 24]
n_validation = 32
n_test = 32
[tuning]
n_trials = 2
surrogate = "refined"
max_epochs = 10
patience = 10
[tuning.search]
n_latent = { kind = "int", low = 4, high = 8, log = true }
n_hidden = { kind = "int", low = 16, high = 32, log = true }
beta = { kind = "float", low = 10.0, high = 100.0, log = true }
[screening]
popsize = 4
maxiter = 10
[polish]
max_calls = 20
"""
STOP_LIMIT_S = 60.0


@pytest.fixture(scope="module", autouse=True)
def needs_a_browser() -> None:
    """Skip before anything is made where nothing could look at it."""
    if importlib.util.find_spec("playwright") is None:
        pytest.skip("playwright is not installed (pip install playwright)")
    if not CHROMIUM:
        pytest.skip("there is no Chromium on this machine (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def project(needs_a_browser: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A project with two studies of two trials and a calibration."""
    root = tmp_path_factory.mktemp("browser") / "project"
    (root / "fmus" / "office").mkdir(parents=True)
    for name in ("Office.fmu", "case.toml"):
        shutil.copy(REPOSITORY / "fmus" / "office" / name, root / "fmus" / "office" / name)
    shutil.copytree(
        REPOSITORY / "data" / "office", root / "data" / "office", ignore=shutil.ignore_patterns("generated")
    )
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    give_store(root)
    (root / "small.toml").write_text(SMALL_PROFILE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STUDIES_ROOT", str(root))
        patch.chdir(root)
        assert main(["tune", "--jobs", "1", "--profile", "small.toml", "--quiet"]) == 0
        assert main(["calibrate", "--n-train", "24", "--profile", "small.toml", "--quiet"]) == 0
        yield root


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
