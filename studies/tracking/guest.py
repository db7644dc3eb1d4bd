"""A guest in the process of a script: MLflow's settings there belong to the script."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from simulation.pool.safe_start import environment_restored


@contextmanager
def settings_of_mlflow_kept() -> Iterator[None]:
    """Undo what work changes of MLflow's tracking URI and experiment, as the script set them or not.

    MLflow's registry and its models know the store and the experiment of the process alone, so work in a
    project sets both. An active run of the script goes on in its own store.
    """
    uri, experiment = (
        _kept("_tracking_service.utils", "_tracking_uri"),
        _kept("fluent", "_active_experiment_id"),
    )
    with environment_restored():
        try:
            yield
        finally:
            # Not imported before nor now: there is nothing to undo.
            if (mlflow := sys.modules.get("mlflow")) is not None:
                if _kept("_tracking_service.utils", "_tracking_uri") != uri:
                    mlflow.set_tracking_uri(uri)
                vars(sys.modules["mlflow.tracking.fluent"])["_active_experiment_id"] = experiment


def _kept(module: str, name: str) -> Any:
    """Return a setting of MLflow, None where it has none or is not imported."""
    return getattr(sys.modules.get(f"mlflow.tracking.{module}"), name, None)
