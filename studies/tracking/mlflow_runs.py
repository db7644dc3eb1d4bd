"""MLflow's runs and experiments: found by their tags, made once, ended when nobody works on them."""

import json
import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from studies.paths import ProjectPaths
from studies.tracking.origin import origin_tags
from studies.tracking.quiet_mlflow import Metric, Param, Run, connect, make_database
from studies.tracking.tracker import History, RunStatus
from studies.tuning.claim import is_dead, this_machine, this_owner
from studies.tuning.trial_store import named_lock, open_trials

TERMINAL = ("FINISHED", "FAILED", "KILLED")
OWNER = "owner"
GRACE_S = 900.0
"""A run of another machine that was not heard of for so long is taken for abandoned; news wakes it again."""

_LOOK_PERIOD_S = 30.0
_N_CURVE_POINTS = 40  # a trial's curves fit in one call, which MLflow limits to 1,000 metrics
_INTERRUPTED = "interrupted"
logger = logging.getLogger(__name__)


class RunStore:
    """The runs of one project.

    Args:
        paths: the project.
    """

    def __init__(self, paths: ProjectPaths) -> None:
        self.artifacts = paths.artifacts.resolve()
        self._paths = paths
        paths.artifacts.mkdir(parents=True, exist_ok=True)
        # Two processes that make a schema or an experiment at the same moment would get in each other's way.
        with self.lock("mlflow"):
            if paths.storage is None and not paths.tracking_database.is_file():
                make_database(paths.tracking_database)
            self.client = connect(paths.tracking_uri)
        self._origin = origin_tags(paths.root)
        self._experiments: dict[str, str] = {}
        self._awake: dict[str, float] = {}
        self._half_written: set[str] = set()
        self._out_of_reach: set[Path] = set()

    def lock(self, name: str) -> AbstractContextManager[Any]:
        """Return a lock of this name that excludes every other process of the project, on any machine."""
        return named_lock(self._paths, f"mlflow/{name}")

    def experiment(self, label: str) -> str:
        """Return the id of a label's experiment, a new one where there is none."""
        if label not in self._experiments:
            with self.lock("mlflow"):
                self._experiments[label] = self._found_or_made(label)
        return self._experiments[label]

    def describe(self, label: str, tags: Mapping[str, str]) -> None:
        """Set those tags of an experiment that it does not have yet or that say something else."""
        experiment = self.experiment(label)
        present = self.client.get_experiment(experiment).tags
        for name, value in tags.items():
            if present.get(name) != value:
                self.client.set_experiment_tag(experiment, name, value)

    def find(self, label: str, tags: Mapping[str, str], *, newest_first: bool = False) -> list[Run]:
        """Return the runs of an experiment that have all of some tags, the earliest first."""
        wanted = " and ".join(f"tags.{name} = '{value}'" for name, value in tags.items())
        order = "DESC" if newest_first else "ASC"
        found: list[Run] = []
        token = None
        while True:
            page = self.client.search_runs(
                [self.experiment(label)],
                wanted,
                order_by=[f"attributes.start_time {order}"],
                max_results=1000,
                page_token=token,
            )
            found += page
            token = page.token
            if not token:
                break
        self._half_written |= {run.info.run_id for run in found if _INTERRUPTED in run.data.tags}
        return found

    def create(self, label: str, name: str, tags: Mapping[str, Any], *, start_ms: int | None = None) -> str:
        """Make a run that belongs to this process, and return its id."""
        said = {**self._origin, **{key: str(value) for key, value in tags.items()}, OWNER: _owner()}
        run = self.client.create_run(self.experiment(label), start_time=start_ms, run_name=name, tags=said)
        self._awake[run.info.run_id] = time.monotonic()
        return str(run.info.run_id)

    def wake(self, run_id: str) -> None:
        """Make a run this process's own and let it run; looks at it twice a minute at most."""
        now = time.monotonic()
        if now - self._awake.get(run_id, -_LOOK_PERIOD_S) < _LOOK_PERIOD_S:
            return
        self._awake[run_id] = now
        self.client.set_tag(run_id, OWNER, _owner())
        if self.client.get_run(run_id).info.status != "RUNNING":
            self.client.update_run(run_id, status="RUNNING")

    def finish(self, run_id: str, status: RunStatus, end_ms: int | None = None) -> None:
        """End a run."""
        self.client.set_terminated(run_id, status, end_ms)
        self._awake.pop(run_id, None)
        if run_id in self._half_written:
            self.client.delete_tag(run_id, _INTERRUPTED)
            self._half_written.discard(run_id)

    def status_of(self, run: Run) -> str:
        """Return a run's status; one that an interruption left half written is still RUNNING."""
        return "RUNNING" if _INTERRUPTED in run.data.tags else str(run.info.status)

    def reaches_artifacts(self, label: str) -> bool:
        """Return whether files of a label's runs can be written from this machine.

        On several machines with one database the files lie where the experiment was made first. Where that
        folder is not to be reached, one warning says so.
        """
        location = self.client.get_experiment(self.experiment(label)).artifact_location
        place = urlparse(location)
        if place.scheme not in ("", "file"):
            return True
        folder = Path(unquote(place.path))
        if folder.is_relative_to(self.artifacts) or folder.is_dir():
            return True
        if folder not in self._out_of_reach:
            self._out_of_reach.add(folder)
            logger.warning(
                "MLflow's files of %s lie in %s, out of this machine's reach: its runs get numbers only, "
                "the registry no model from here",
                label,
                folder,
            )
        return False

    def end_ghosts(self) -> list[str]:
        """End the runs that say RUNNING and whose process is no more; return their names."""
        experiments = [one.experiment_id for one in self.client.search_experiments()]
        ended = []
        for run in self.client.search_runs(experiments, "attributes.status = 'RUNNING'", max_results=1000):
            tags = run.data.tags
            if "role" not in tags or _is_alive(tags.get(OWNER, ""), run) or self._is_worked_on(tags):
                continue
            # Telling it once more completes a trial or a stage; until then it is what it is, unfinished.
            self.client.set_tag(run.info.run_id, _INTERRUPTED, "yes")
            self.client.set_terminated(run.info.run_id, "KILLED")
            ended.append(run.info.run_name)
        return ended

    def _is_worked_on(self, tags: Mapping[str, str]) -> bool:
        """Return whether somebody, on any machine, trains a trial of the study that a run shows."""
        if tags["role"] != "study":
            return False
        claims = open_trials(self._paths, tags["study_key"]).claims()
        return any(claim.is_owned and not is_dead(claim.owner, silence) for claim, silence in claims)

    def _found_or_made(self, label: str) -> str:
        found = self.client.get_experiment_by_name(label)
        if found is None:
            return str(self.client.create_experiment(label, (self.artifacts / label).as_uri()))
        if found.lifecycle_stage == "deleted":
            self.client.restore_experiment(found.experiment_id)
        return str(found.experiment_id)


def params(values: Mapping[str, Any]) -> list[Param]:
    """Return settings as MLflow keeps them."""
    return [Param(name, str(value)[:6000]) for name, value in values.items()]


def thinned(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """Keep so many points of a curve that a chart of it looks the same, its ends among them."""
    if len(curve) <= _N_CURVE_POINTS:
        return list(curve)
    last = len(curve) - 1
    kept = sorted({round(i * last / (_N_CURVE_POINTS - 1)) for i in range(_N_CURVE_POINTS)})
    return [curve[i] for i in kept]


def curve_points(history: History, start_ms: int, end_ms: int) -> list[Metric]:
    """Return a training's learning curves, thinned, as metrics over its epochs.

    Args:
        history: the curves; "epoch" tells where their points lie.
        start_ms: when the training began. [ms since 1970]
        end_ms: when it ended. [ms since 1970]
    """
    epochs = [int(epoch) for epoch in history.get("epoch", [])]
    points = []
    for name, curve in history.items():
        if name != "epoch":
            for epoch, value in thinned(list(zip(epochs, map(float, curve), strict=True))):
                at = start_ms + round((end_ms - start_ms) * epoch / epochs[-1])
                points.append(Metric(f"curve/{name}", value, at, epoch))
    return points


def ms(seconds: float) -> int:
    """Return a time as MLflow counts it. [ms since 1970]."""
    return round(1000.0 * seconds)


def _owner() -> str:
    return json.dumps({**this_owner(), "heard_s": round(time.time())})


def _is_alive(owner: str, run: Run) -> bool:
    """Return whether the process that a run belongs to still works, as far as can be told from here."""
    try:
        said = json.loads(owner)
        silence_s = time.time() - float(said["heard_s"])
        return not is_dead(said, 0.0) if said["machine"] == this_machine() else silence_s < GRACE_S
    except (ValueError, KeyError, TypeError):
        return bool(time.time() - run.info.start_time / 1000.0 < GRACE_S)
