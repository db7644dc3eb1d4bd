"""Runs of a project on their way to a server: what differs there is sent, and nothing is sent twice.

The project's own store is written first and is what a server that was away gets later. A run has the
tag `studies.run` there, and is noted before it is made: whoever goes on after a kill finds it again.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mlflow.models import Model

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.results.declaration import ALIAS
from studies.server import Server
from studies.tracking.leaderboard import SHARED_VIEW
from studies.tracking.quiet_mlflow import (
    LocalArtifactRepository,
    connect,
    entities,
    get_artifact_repository,
    mlflow,
)
from studies.tracking.sent_runs import SentRuns
from studies.tracking.shared_names import PROJECT, own_experiment, own_model
from studies.tracking.study_tags import PARENT, RUN, TRACKING

_MOST_POINTS, _MOST_WORDS = 900, 90  # of a call; MLflow allows 1,000 metrics, 100 parameters and 100 tags


class ServerAwayError(Exception):
    """The server does not answer; the message is what was said last."""


class Outbox:
    """Sends what a project has and its server has not.

    Args:
        paths: the project.
        server: its server.
        warn: called with a line on what cannot be sent, once each.
    """

    def __init__(self, paths: ProjectPaths, server: Server, warn: Callable[[str], None]) -> None:
        self._paths, self._server, self._warn = paths, server, warn
        self._said: set[str] = set()
        self._checked: set[str] = set()
        self._own = connect(paths.tracking_uri)
        self._there = mlflow.MlflowClient(server.uri, server.registry)
        try:
            self._sent = SentRuns.read(paths, server)
        except InputError as damaged:  # the server is asked
            warn(f"{damaged}; it is written anew")
            self._sent = SentRuns(server.uri)
        # Without notes, as of a damaged file, any run may be there.
        self._is_known = bool(self._sent.experiments)
        self._new: set[str] = set()
        self._n_points: dict[tuple[str, str], int] = {}
        # Parameters and tags that this process has written, by run.
        self._written: dict[str, dict[str, dict[str, str]]] = {}

    def send(self) -> int:
        """Send what is missing there, and return how many runs are still missing.

        Raises:
            ServerAwayError: the server does not answer.
        """
        n_left, runs = 0, [*self._runs()]
        self._new = {run.info.run_id for _, run in runs} - self._sent.runs.keys()
        if self._new:
            self._sent.runs |= {run_id: {} for run_id in self._new}
            self._sent.write(self._paths, self._server)
        if not self._is_known:
            self._new, self._is_known = set(), True
        for label, run in runs:
            content = self._content(run)
            noted = self._sent.runs.get(run.info.run_id, {})
            if noted.get("content") == content["digest"] or noted.get("id") == "":
                continue
            if self._is_done(
                f"MLflow's run {run.info.run_id}", lambda r=run, c=content, n=label: self._send(n, r, c)
            ):
                self._sent.write(self._paths, self._server)
            else:
                n_left += self._sent.runs.get(run.info.run_id, {}).get("id") != ""
        for model in self._own.search_registered_models():
            self._is_done(f"the model {model.name}", lambda m=model: self._send_model(m))
        self._sent.write(self._paths, self._server)
        return n_left

    def n_missing(self, *, with_running: bool = True) -> int:
        """Return how many runs the server has not, or not as they are; it is not asked.

        Args:
            with_running: whether runs that go on count, which may be another command's.
        """
        noted = self._sent.runs
        return sum(
            noted.get(run.info.run_id, {}).get("content") != self._content(run)["digest"]
            and noted.get(run.info.run_id, {}).get("id") != ""
            for _, run in self._runs()
            if with_running or run.info.status != "RUNNING"
        )

    def _runs(self) -> Iterator[tuple[str, entities.Run]]:
        """Give the runs that were made for this server with their labels, the earliest first."""
        identity = self._paths.identity
        for experiment in self._own.search_experiments():
            page: str | None = ""
            while page is not None:
                part = self._own.search_runs(
                    [experiment.experiment_id],
                    f"tags.`{TRACKING}` = '{self._server.uri}'",
                    order_by=["attributes.start_time ASC"],
                    page_token=page or None,
                )
                page = part.token or None
                for run in part:
                    if run.data.tags.get(PROJECT, identity) == identity:
                        yield run.data.tags.get("label", experiment.name), run

    def _content(self, run: entities.Run) -> dict[str, Any]:
        """Return what is to be there of a run, and a digest of it."""
        tags = {name: one for name, one in run.data.tags.items() if name != TRACKING}
        if parent := tags.pop(PARENT, ""):
            # A parent that is not there yet is named as soon as it is.
            tags |= {PARENT: there} if (there := self._sent.id_of(parent)) else {}
        tags |= {RUN: run.info.run_id, PROJECT: self._paths.identity, **dict(self._server.tags)}
        place = self._folder(run.info.artifact_uri)
        files = [one for one in place.rglob("*") if one.is_file()] if place is not None else []
        content: dict[str, Any] = {
            "name": run.info.run_name,
            "params": dict(run.data.params),
            "tags": tags,
            # The curves of a run that goes on are known by their latest points.
            "metrics": sorted((one.key, one.step, one.value) for one in run.data._metric_objs),
            "files": {
                one.relative_to(place).as_posix(): [one.stat().st_size, one.stat().st_mtime_ns]
                for one in sorted(files)
                if place is not None
            },
            "status": run.info.status,
            "end": run.info.end_time,
        }
        content["digest"] = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
        return content

    def _folder(self, place: str) -> Path | None:
        """Return the folder of artifacts where they lie on this disk."""
        files = get_artifact_repository(place, tracking_uri=self._paths.tracking_uri)
        return Path(files.artifact_dir) if isinstance(files, LocalArtifactRepository) else None

    def _is_done(self, what: str, work: Callable[[], None]) -> bool:
        """Do work with the server; say in a line why it refuses.

        Raises:
            ServerAwayError: it does not answer.
        """
        try:
            work()
        except (mlflow.MlflowException, OSError) as error:
            said = _line_of(error)
            try:
                self._there.search_experiments(max_results=1)
            except (mlflow.MlflowException, OSError) as away:
                raise ServerAwayError(_line_of(away)) from None
            self._say(f"{what} is not sent to {self._server.uri}: {said}")
            return False
        return True

    def _say(self, line: str) -> None:
        if line not in self._said:
            self._said.add(line)
            self._warn(line)

    def _send(self, label: str, run: entities.Run, content: dict[str, Any]) -> None:
        noted, experiment = self._sent.runs[run.info.run_id], self._experiment(label, run)
        if "id" not in noted:
            noted["id"] = self._found_or_made(experiment, run, content)
            self._sent.write(self._paths, self._server)
        try:
            self._send_parts(run, content, noted)
        except mlflow.MlflowException:
            # A server writes to no run that was deleted.
            if self._there.get_run(noted["id"]).info.lifecycle_stage != "deleted":
                raise
            noted["id"] = ""
            self._say(f"run {content['name']} was deleted on {self._server.uri}; it stays in the project")

    def _send_parts(self, run: entities.Run, content: dict[str, Any], noted: dict[str, Any]) -> None:
        run_id, sent_id, there = run.info.run_id, noted["id"], self._there
        if noted.get("status") not in (None, "RUNNING") and content["status"] == "RUNNING":
            there.update_run(sent_id, status="RUNNING")
        for name in {*noted.get("tags", [])} - {*content["tags"]}:
            there.delete_tag(sent_id, name)
        written = self._written.pop(run_id, {})
        new = {kind: content[kind].items() - written.get(kind, {}).items() for kind in ("params", "tags")}
        words = [entities.Param(*one) for one in sorted(new["params"])]
        marks = [entities.RunTag(*one) for one in sorted(new["tags"])]
        points = [one for key, *_ in content["metrics"] for one in self._new_points(run_id, key)]
        for at in range(0, max(len(words), len(marks), 1), _MOST_WORDS):
            part = slice(at, at + _MOST_WORDS)
            there.log_batch(sent_id, points[:_MOST_POINTS] if at == 0 else (), words[part], marks[part])
        for at in range(_MOST_POINTS, len(points), _MOST_POINTS):
            there.log_batch(sent_id, points[at : at + _MOST_POINTS])
        for point in points:
            self._n_points[run_id, point.key] = self._n_points.get((run_id, point.key), 0) + 1
        self._written[run_id] = {"params": content["params"], "tags": content["tags"]}
        folder, files = self._folder(run.info.artifact_uri), noted.setdefault("files", {})
        for name, state in content["files"].items():
            if folder is not None and files.get(name) != state:
                inside = Path(name).parent.as_posix()
                there.log_artifact(sent_id, str(folder / name), None if inside == "." else inside)
                files[name] = state
        if content["status"] != "RUNNING":
            there.set_terminated(sent_id, content["status"], content["end"])
        noted |= {"content": content["digest"], "tags": [*content["tags"]], "status": content["status"]}

    def _found_or_made(self, experiment: str, run: entities.Run, content: dict[str, Any]) -> str:
        """Return the id of a run on the server; it is made there unless a killed command has."""
        if run.info.run_id not in self._new:
            same = f"tags.`{RUN}` = '{run.info.run_id}'"
            known = self._there.search_runs([experiment], same, run_view_type=entities.ViewType.ALL)
            if known:
                return str(known[0].info.run_id)
        tags, name = dict([*content["tags"].items()][:_MOST_WORDS]), content["name"]
        made = self._there.create_run(experiment, start_time=run.info.start_time, run_name=name, tags=tags)
        self._written[run.info.run_id] = {"tags": tags}
        return str(made.info.run_id)

    def _experiment(self, label: str, run: entities.Run) -> str:
        if label not in self._checked:
            given, known = self._server.experiment, self._sent.experiments.get(label)
            name = f"{given}{label}" if given.endswith("/") or not given else given
            if known and self._there.get_experiment(known).lifecycle_stage == "deleted":
                self._say(
                    f"experiment {name} was deleted on {self._server.uri}: restored, for runs are sent there"
                )
            there = self._sent.experiments[label] = own_experiment(self._there, name, self._paths.identity)
            for tag, view in self._own.get_experiment(run.info.experiment_id).tags.items():
                if tag.startswith(SHARED_VIEW):
                    self._there.set_experiment_tag(there, tag, view)
            self._checked.add(label)
        return self._sent.experiments[label]

    def _new_points(self, run_id: str, key: str) -> list[entities.Metric]:
        """Return the points of a curve that were not sent by this process; a server drops those it has."""
        history = self._own.get_metric_history(run_id, key)
        return list(history[self._n_points.get((run_id, key), 0) :])

    def _send_model(self, model: Any) -> None:
        """Register the champion of a model there, unless that was done."""
        version = (
            self._own.get_model_version(model.name, model.aliases[ALIAS]) if ALIAS in model.aliases else None
        )
        noted = self._sent.models.get(model.name, {})
        run_id = (version.run_id if version is not None else "") or ""
        sent_id = self._sent.id_of(run_id)
        if version is None or not sent_id or noted.get("run") == run_id:
            return
        try:
            name = own_model(self._there, model.name, self._paths.identity)
            known = self._there.search_model_versions(f"name = '{name}' and run_id = '{sent_id}'")
            number = known[0].version if known else self._registered(name, version, sent_id)
            self._there.set_registered_model_alias(name, ALIAS, str(number))
        except mlflow.MlflowException as error:
            # A proxy may serve runs alone.
            if "404" not in str(error) and error.error_code not in ("ENDPOINT_NOT_FOUND", "FEATURE_DISABLED"):
                raise
            self._say(f"{self._server.registry} has no model registry: models stay in the project")
            return
        self._sent.models[model.name] = {"name": name, "run": run_id, "version": str(number)}

    def _registered(self, name: str, version: Any, sent_id: str) -> str:
        """Log a model of the project there, register it, and return its version."""
        there, run = self._there, self._there.get_run(sent_id)
        params, folder = run.data.params, self._folder(version.source)
        if folder is None or not folder.is_dir():
            raise OSError(f"its files are not on this machine ({version.source})")
        made = there.create_logged_model(run.info.experiment_id, name, sent_id, params=params)
        model = Model.load(str(folder))
        model.run_id, model.model_id, model.model_uuid = sent_id, made.model_id, made.model_id
        model.artifact_path = made.artifact_location
        with TemporaryDirectory(prefix="studies-model-") as scratch:
            there.log_model_artifacts(made.model_id, str(folder))
            model.save(str(Path(scratch) / "MLmodel"))
            there.log_model_artifacts(made.model_id, scratch)
        there.finalize_logged_model(made.model_id, "READY")
        there.log_outputs(sent_id, [entities.LoggedModelOutput(made.model_id, step=0)])
        # A database looks for the id of a model in the store of the process; a server does not.
        is_database = self._server.uri.startswith("sqlite:")
        added = there.create_model_version(
            name,
            source=made.artifact_location if is_database else f"models:/{made.model_id}",
            run_id=sent_id,
            description=version.description,
            model_id=None if is_database else made.model_id,
        )
        return str(added.version)


def _line_of(error: BaseException) -> str:
    line = next(iter(str(error).splitlines()), type(error).__name__)
    return line[:200]
