"""What holds for all tests."""

import atexit
import functools
import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import mlflow_store_for_tests
import pytest
from _pytest import runner
from alembic.util import pyfiles
from made_once import made_once

if TYPE_CHECKING:
    from postgres_for_tests import PostgresServer

# A shell starts background jobs with Ctrl-C ignored, which they pass on; tests interrupt processes.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Several processes test side by side: threads of one would only take the processors of the others.
for library in ("OMP", "MKL", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Processes that simulate are forked from one that has imported what they need. Another environment needs
# another one of these, which takes a second: so no test has a variable of its own without need.
os.environ.pop("STUDIES_ROOT", None)
runner._update_current_test_var = lambda item, when: None  # it says in the environment which test runs


# Alembic runs the files of MLflow's 50 schema versions again for every new database, 0.3 s each time.
_load, _load_once = pyfiles.load_module_py, functools.cache(pyfiles.load_module_py)
pyfiles.load_module_py = lambda name, path: (_load if name == "env_py" else _load_once)(name, path)


# No test depends on how busy the machine is.
hypothesis.settings.register_profile("patient", deadline=None)
hypothesis.settings.load_profile("patient")


# No garbage is looked for among what the imports make; pytest_collection_finish ends this.
gc.disable()


# Tests look for what is left in the temporary folder, so processes that test side by side have one each.
if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    own = Path(tempfile.mkdtemp(prefix=f"tests-{worker}-"))
    own.chmod(0o755)  # PostgreSQL's server runs as another user
    os.environ["TMPDIR"], tempfile.tempdir = str(own), None
    atexit.register(shutil.rmtree, own, ignore_errors=True)


# What takes minutes begins first: begun last, it would run alone at the end.
LONGEST = (
    "test_quick_profile",
    "test_cli_resume",
    "test_killed",
    "test_house",
    "test_notebook",
    "test_reproduce_paper",
    "test_cli_adaptive",
    "test_tutorials",
    "test_reproduce",
    "test_trials",
    "test_sent",
    "test_company_mlflow",
    "test_budget",
    "test_away",
    "test_server",
    "test_doctor",
    "test_package",
    "test_browser",
    "test_pool_executors",
    "test_pool_killed",
    "test_state_functions",
    "test_state_equations",
    "test_bad_fmus",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first, for processes that test side by side."""
    place = {name: at for at, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Leave what the imports have made, a million objects, out of the garbage collection."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Leave out all: Pytest collects ten times at its end, and Python once more."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _one_empty_store(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Say where the empty MLflow store is made that projects begin with."""
    mlflow_store_for_tests.factory = tmp_path_factory


@pytest.fixture(autouse=True)
def _no_server_of_another_test() -> None:
    """Forget what `mlflow.set_tracking_uri` has written into the environment, where commands look for it."""
    os.environ.pop("MLFLOW_TRACKING_URI", None)


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which the office was run with the profile "smoke".

    Other processes copy it: who opens its databases opens those of a copy.
    """
    from project_for_tests import finish, make_validated_project

    return made_once(tmp_path_factory, "whole-run", lambda root: finish(make_validated_project(root)))


@pytest.fixture(scope="session")
def postgres_server() -> Iterator["PostgresServer"]:
    """A throwaway PostgreSQL cluster."""
    from postgres_for_tests import PostgresServer, missing_postgres

    if reason := missing_postgres():
        pytest.skip(reason)
    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture
def storage(postgres_server: "PostgresServer") -> Iterator[str]:
    """URL of an empty database; connections to it are closed afterwards, whoever forgot them."""
    yield postgres_server.new_database()
    import sqlalchemy

    for engine in [found for found in gc.get_objects() if type(found) is sqlalchemy.Engine]:
        if engine.url.port == postgres_server.port:
            engine.dispose()
