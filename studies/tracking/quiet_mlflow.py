"""MLflow without telemetry, log chatter and the deprecation warnings of its own dependencies."""

import logging
import os
import warnings

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")  # read while MLflow is imported
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")  # bars are the command line's
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from mlflow import MlflowClient
    from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, Run, RunTag

for _name in ("alembic", "mlflow"):  # after the import, which sets levels of its own
    logging.getLogger(_name).setLevel(logging.WARNING)
# It prints tracebacks of errors that it raises as well; who catches them says one line.
logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)

__all__ = [
    "Dataset",
    "DatasetInput",
    "InputTag",
    "Metric",
    "MlflowClient",
    "Param",
    "Run",
    "RunTag",
    "connect",
]


def connect(uri: str) -> MlflowClient:
    """Open the store at a URI for runs and models alike; an SQLite file gets its schema here (some 7 s)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        client = MlflowClient(tracking_uri=uri, registry_uri=uri)
        client.search_registered_models(max_results=1)  # opens the registry's half too
        return client
