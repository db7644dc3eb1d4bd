"""Results as MLflow recorded them: from tags that go with the database, and from artifacts within reach."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlparse

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.recipe import MEMORY, RECIPE_FILE, checked, unpacked
from studies.reproduction.recorded import REPEATABLE, Arrays, Recorded, as_arrays, numbers_of, stage_record
from studies.stages.results import read_arrays
from studies.tuning.trial_record import TrialRecord, best_record, record_from_json

if TYPE_CHECKING:
    from studies.tracking.quiet_mlflow import Run

_STAGES = ("calibration", "uncertainty", "sensitivity")
_CURVE = "curve/"


class MlflowRecords:
    """Reads the runs of a project.

    Args:
        paths: the project.

    """

    def __init__(self, paths: ProjectPaths) -> None:
        from studies.tracking.quiet_mlflow import connect

        self._paths = paths
        self._client = connect(paths.tracking_uri)

    def find(self, prefix: str) -> Recorded | None:
        """Find the run whose id begins so, or for a study's run its best trial; None where there is none.

        Raises:
            InputError: there is more than one, or it is of a kind that is not made again.
        """
        run = self._one(prefix)
        if run is None:
            return None
        role = run.data.tags.get("role", "")
        if role == "trial":
            return self._trial(run)
        if role == "study":
            records = self._records(run.info.experiment_id, run.data.tags["study_key"])
            best = best_record(list(records))
            if best is None:
                raise InputError(f"the study of run {run.info.run_id} has no completed trial")
            (found,) = self._search(run.info.experiment_id, f"tags.trial_key = '{best.key}'")[:1]
            return self._trial(found)
        if role in _STAGES:
            return self._stage(run)
        raise InputError(
            f"run {run.info.run_id[:8]} ({run.info.run_name}) is a {role or 'run of another program'}; "
            f"{REPEATABLE} can be made again"
        )

    def _one(self, prefix: str) -> "Run | None":
        experiments = [one.experiment_id for one in self._client.search_experiments()]
        found = self._client.search_runs(experiments, f"attributes.run_id LIKE '{prefix}%'", max_results=5)
        if len(found) <= 1:
            return found[0] if found else None
        several = ", ".join(f"{run.info.run_id[:12]} ({run.info.run_name})" for run in found[:3])
        raise InputError(f"{prefix} begins several runs: {several}; give more digits")

    def _search(self, experiment: str, wanted: str) -> "list[Run]":
        found: list[Run] = []
        token = None
        while True:
            page = self._client.search_runs([experiment], wanted, max_results=1000, page_token=token)
            found += page
            token = page.token
            if not token:
                return found

    def _records(self, experiment: str, study: str) -> tuple[TrialRecord, ...]:
        """Return the trials of a study as their runs have them, ordered by index."""
        runs = self._search(experiment, f"tags.study_key = '{study}' and tags.role = 'trial'")
        records = [_record(run) for run in runs]
        return tuple(sorted((r for r in records if r is not None), key=lambda record: record.index))

    def _trial(self, run: "Run") -> Recorded:
        record = _record(run)
        key = run.data.tags["trial_key"]
        if record is None:
            raise InputError(f"run {run.info.run_id[:8]} has no record of its trial; name it instead: {key}")
        experiment, study = run.info.experiment_id, record.study
        (parent,) = self._search(experiment, f"tags.study_key = '{study}' and tags.role = 'study'")[:1] or [
            run
        ]
        return Recorded(
            name=key,
            place=f"MLflow, run {run.info.run_id}",
            recipe=checked(self._json(parent, "recipe", RECIPE_FILE), key),
            environment=record.environment,
            numbers=numbers_of(record),
            arrays=self._curves(run),
            trial=record,
            rivals=self._records(experiment, study),
        )

    def _curves(self, run: "Run") -> Arrays:
        """Return a training's learning curves; MLflow has some of their points, each with its epoch."""
        names = sorted(name for name in run.data.metrics if name.startswith(_CURVE))
        curves: dict[str, list[float]] = {}
        for name in names:
            points = sorted(
                self._client.get_metric_history(run.info.run_id, name), key=lambda point: point.step
            )
            curves.setdefault("epoch", [float(point.step) for point in points])
            curves[name.removeprefix(_CURVE)] = [point.value for point in points]
        return as_arrays(curves)

    def _stage(self, run: "Run") -> Recorded:
        name = f"{run.data.tags.get('label', '')}/{run.info.run_name}"
        content = {
            "recipe": self._json(run, "recipe", RECIPE_FILE),
            "environment": self._json(run, "environment", "environment.json"),
        }
        artifacts = self._artifacts(run)
        numbers: Mapping[str, Any] = {}
        arrays: Arrays = {}
        if artifacts is not None:
            for what in ("calibration-*.json", "posterior-*.json"):
                for file in artifacts.glob(what):
                    numbers = json.loads(file.read_text(encoding="utf-8"))
            for file in artifacts.glob("*.npz"):
                arrays = read_arrays(file)
        numbers = numbers or self._json(run, "numbers", "") or _plain_metrics(run)
        return stage_record(name, content, numbers, arrays, place=f"MLflow, run {run.info.run_id}")

    def _json(self, run: "Run", what: str, file_name: str) -> dict[str, Any]:
        """Return packed values of a tag, or those of an artifact; empty without either."""
        if cell := run.data.tags.get(f"{MEMORY}{what}"):
            return unpacked(cell)
        folder = self._artifacts(run)
        file = None if folder is None else folder / file_name
        if not file_name or file is None or not file.is_file():
            return {}
        content = json.loads(file.read_text(encoding="utf-8"))
        return content if isinstance(content, dict) else {}

    def _artifacts(self, run: "Run") -> Path | None:
        """Return the folder of a run's files, also where the project was moved; None where out of reach."""
        place = urlparse(run.info.artifact_uri)
        if place.scheme not in ("", "file"):
            return None
        folder = Path(unquote(place.path))
        label = run.data.tags.get("label", "")
        moved = self._paths.artifacts / label / run.info.run_id / "artifacts"
        return next((one for one in (moved, folder) if one.is_dir()), None)


def find_run(paths: ProjectPaths, prefix: str) -> Recorded | None:
    """Find what MLflow recorded under an id or the first digits of one; None where it has nothing such.

    Raises:
        InputError: several runs begin so, or it is of a kind that is not made again.
    """
    if paths.storage is None and not paths.tracking_database.is_file():
        return None
    return MlflowRecords(paths).find(prefix)


def _record(run: "Run") -> TrialRecord | None:
    cell = run.data.tags.get(f"{MEMORY}record")
    return record_from_json(json.dumps(unpacked(cell))) if cell else None


def _plain_metrics(run: "Run") -> dict[str, Any]:
    """Return the metrics that bear the name of a number; the others are drawn from them."""
    names = {"mse/surrogate": "mse_surrogate", "mse/screened": "mse_screened", "mse/polished": "mse_polished"}
    names |= {"mse/calibrated": "mse", "mse/screening_gap": "screening_gap"}
    return {names[name]: value for name, value in run.data.metrics.items() if name in names}
