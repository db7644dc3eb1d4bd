"""MLflow's runs of a project: made, written to while the work goes on, found again, and ended.

The only module, with `registry`, that speaks to MLflow's client.
"""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

from simulation.errors import InputError
from simulation.file_lock import FileLock
from simulation.foreign_text import without_pictures
from studies.paths import ProjectPaths, cannot_open, folder_name
from studies.tracking.origin import origin_tags
from studies.tracking.quiet_mlflow import connect, entities, make_database, mlflow

Run: TypeAlias = entities.Run
RunStatus = Literal["FINISHED", "FAILED", "KILLED", "RUNNING"]
NOTE, PARENT = "mlflow.note.content", "mlflow.parentRunId"
CURVE = "curve/"
SCHEME = "studies-project"
"""Of artifacts that lie in the project, see `studies.tracking.artifacts`."""
MAX_METRICS = 1000  # of one call, MLflow's limit


class RunStore:
    """The runs of one project.

    Args:
        paths: the project.

    Raises:
        InputError: MLflow cannot use the store.
        MachineError: the store does not answer, or its disk is full.
    """

    def __init__(self, paths: ProjectPaths) -> None:
        self._paths = paths
        self._artifacts = paths.artifacts.resolve()
        self._artifacts.mkdir(parents=True, exist_ok=True)
        try:
            # Processes that make the database at the same moment would get in each other's way.
            with FileLock(paths.mlruns / ".mlflow.lock"):
                if paths.storage is None and not paths.tracking_database.is_file():
                    make_database(paths.tracking_database)
                self.client = connect(paths.tracking_uri)
        except (OSError, InputError):
            raise
        except Exception as error:
            raise cannot_open(paths, "MLflow", paths.tracking_database, error) from None
        self._origin = origin_tags()
        self._experiments: dict[str, str] = {}

    def experiment(self, label: str) -> str:
        """Return the id of a label's experiment, a new one where there is none."""
        if label not in self._experiments:
            # On a server there is no file that artifacts could lie beside: they lie in this project's folder.
            folder = folder_name(label)
            lies_beside = self._paths.storage is None
            location = f"{SCHEME}:/{folder}" if lies_beside else (self._artifacts / folder).as_uri()
            with FileLock(self._paths.mlruns / ".mlflow.lock"):
                known = self.client.get_experiment_by_name(label)
                found = known.experiment_id if known else self.client.create_experiment(label, location)
                if known and known.lifecycle_stage == "deleted":
                    self.client.restore_experiment(found)
            self._experiments[label] = str(found)
        return self._experiments[label]

    def describe(self, label: str, note: str) -> None:
        """Set the text at the head of a label's page."""
        self.client.set_experiment_tag(self.experiment(label), NOTE, without_pictures(note))

    def find(self, label: str, tags: Mapping[str, str], *, status: RunStatus | None = None) -> list[Run]:
        """Return the runs of an experiment that have all of some tags, the earliest first."""
        wanted = [f"tags.`{name}` = '{value}'" for name, value in tags.items()]
        wanted += [f"attributes.status = '{status}'"] if status else []
        where, order = [self.experiment(label)], ["attributes.start_time ASC"]
        query = " and ".join(wanted)
        return list(mlflow.search_runs(where, query, order_by=order, output_format="list"))

    def begin(self, label: str, name: str, tags: Mapping[str, Any], *, start_s: float | None = None) -> str:
        """Make a run, and return its id."""
        start = None if start_s is None else round(1000.0 * start_s)
        said = {**self._origin, "label": label, **{key: str(value) for key, value in tags.items()}}
        said |= {NOTE: without_pictures(said[NOTE])} if NOTE in said else {}
        run = self.client.create_run(self.experiment(label), start_time=start, run_name=name, tags=said)
        return str(run.info.run_id)

    def log(
        self,
        run_id: str,
        *,
        params: Mapping[str, Any] | None = None,
        metrics: Mapping[str, float] | None = None,
        tags: Mapping[str, Any] | None = None,
    ) -> None:
        """Write settings, results and tags of a run; a metric that is no finite number is left out."""
        now = round(1000.0 * time.time())
        finite = {name: float(value) for name, value in (metrics or {}).items() if math.isfinite(value)}
        results = [entities.Metric(name, value, now, 0) for name, value in finite.items()]
        settings = [entities.Param(name, str(value)[:6000]) for name, value in (params or {}).items()]
        marks = [entities.RunTag(name, str(value)) for name, value in (tags or {}).items()]
        self.client.log_batch(run_id, metrics=results, params=settings, tags=marks)

    def log_points(self, run_id: str, points: Sequence[entities.Metric]) -> None:
        """Write points of curves."""
        for begin in range(0, len(points), MAX_METRICS):
            self.client.log_batch(run_id, metrics=points[begin : begin + MAX_METRICS])

    def log_files(self, run_id: str, files: Iterable[Path], folder: str | None = None) -> None:
        """Copy files among a run's artifacts."""
        for file in files:
            self.client.log_artifact(run_id, str(file), folder)

    def fetch(self, run_id: str, name: str, folder: Path) -> Path:
        """Copy an artifact of a run into a folder.

        Raises:
            InputError: the run has none of that name, or it is out of this machine's reach.
        """
        try:
            return Path(self.client.download_artifacts(run_id, name, str(folder)))
        except (mlflow.MlflowException, OSError) as error:
            line = next(iter(str(error).splitlines()), "")
            raise InputError(f"MLflow's run {run_id} has no {name} that can be read here ({line})") from None

    def end(self, run_id: str, status: RunStatus, *, end_s: float | None = None) -> None:
        """End a run."""
        self.client.set_terminated(run_id, status, None if end_s is None else round(1000.0 * end_s))
