"""MLflow plug-in: artifacts that lie beside the project's SQLite file, wherever the project was moved.

MLflow keeps absolute places of artifacts, which are wrong once a folder is moved. An address
`studies-project:/<label>/...` means `artifacts/<label>/...` in the folder of the SQLite file in use.

MLflow loads this module while it is imported itself: no module of ours imports it.
"""

import os
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

import mlflow
from mlflow.exceptions import MlflowException
from mlflow.store.artifact.local_artifact_repo import LocalArtifactRepository

from simulation.write_gate import check_written


class ProjectArtifacts(LocalArtifactRepository):
    """Reads and writes artifacts in the project's folder."""

    def __init__(
        self, artifact_uri: str, tracking_uri: str | None = None, registry_uri: str | None = None
    ) -> None:
        # MLflow's server does not pass its store on; it keeps it in this variable.
        served = os.environ.get("_MLFLOW_SERVER_FILE_STORE")
        known = [uri for uri in (tracking_uri, served, mlflow.get_tracking_uri()) if uri]
        store = next((uri for uri in known if uri.startswith("sqlite:")), None)
        if store is None:
            raise MlflowException(f"{artifact_uri}: set the tracking URI to the project's mlruns/mlflow.db")
        root = (Path(urlparse(store).path.removeprefix("/")).resolve().parent / "artifacts").resolve()
        named = root / unquote(urlparse(artifact_uri).path).lstrip("/")
        check_written(named)
        place = named.resolve()
        if not place.is_relative_to(root):
            raise MlflowException(f"{artifact_uri} lies outside the project's artifacts")
        super().__init__(place.as_uri(), tracking_uri, registry_uri)

    def log_artifact(self, *arguments: Any, **options: Any) -> None:
        """Copy a file among the artifacts; no link there leads it out of the project."""
        self._check_links()
        super().log_artifact(*arguments, **options)

    def log_artifacts(self, *arguments: Any, **options: Any) -> None:
        """Copy the files of a folder among the artifacts; no link there leads them out of it."""
        self._check_links()
        super().log_artifacts(*arguments, **options)

    def _check_links(self) -> None:
        # A run has a few files: to check all of them is simpler than to know MLflow's names of new ones.
        place = Path(self.artifact_dir)
        for one in (place, *place.rglob("*")):
            check_written(one)
