"""Python processes that are started do not import modules from the working folder, which may be a stranger's.

`python -c` and `python -m` look there first: a file `multiprocessing.py` in it would be run by every process
that multiprocessing starts.
"""

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

_VARIABLE = "PYTHONSAFEPATH"
_OURS = "studies"  # any text switches it on
# The URL of a database may hold a password; of MLflow's and Databricks' variables some are one.
_SECRET = re.compile(r"STUDIES_STORAGE|(MLFLOW_|DATABRICKS_).*(PASSWORD|TOKEN|SECRET).*")


def start_safely() -> None:
    """Have the processes that this one starts leave the working folder out of what they import from."""
    os.environ.setdefault(_VARIABLE, _OURS)


@contextmanager
def environment_restored() -> Iterator[None]:
    """Undo what is changed in the environment of this process meanwhile."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def as_for_fmus(environment: Mapping[str, str]) -> dict[str, str]:
    """Return an environment without this, as an FMU may be a Python script that imports its neighbours.

    The studies' storage, passwords and tokens are none of its business either.
    """
    return {
        name: value
        for name, value in environment.items()
        if not _SECRET.fullmatch(name) and (name, value) != (_VARIABLE, _OURS)
    }
