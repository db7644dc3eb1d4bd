"""A finished stage other than tuning as MLflow shows it: numbers, curves, pictures, its provenance."""

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from studies.paths import ProjectPaths
from studies.tracking.quiet_mlflow import entities
from studies.tracking.runs import NOTE, RunStore

_REFUSED = re.compile(r"[^/\w.\- :]")


@dataclass(frozen=True)
class StageRun:
    """A finished stage.

    Args:
        label: label of the study; MLflow's experiment.
        kind: what it is, for example "calibration" or "sensitivity".
        name: name a user reads, for example "n0064 calibration".
        key: digest of the stage's inputs; a stage logged before with the same key and metrics is not logged
            again.
        params: settings.
        metrics: results, one number each.
        curves: results over steps: pairs of step and value, for example the best MSE over model calls.
        tags: what to search for (case, n_train, digests, ...).
        figures: image files.
        artifacts: other files.
        started_s: start of the stage. [s since 1970, UTC]
        wall_s: its duration. [s]
        note: Markdown, shown on the run's page.
        record: what makes it again, kept as `provenance.json`; empty where nothing does.
    """

    label: str
    kind: str
    name: str
    key: str
    params: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, Sequence[tuple[int, float]]] = field(default_factory=dict)
    tags: Mapping[str, Any] = field(default_factory=dict)
    figures: Sequence[Path] = ()
    artifacts: Sequence[Path] = ()
    started_s: float | None = None
    wall_s: float = 0.0
    note: str = ""
    record: Mapping[str, Any] = field(default_factory=dict)


@lru_cache(maxsize=4)
def run_store(paths: ProjectPaths) -> RunStore:
    """Return the project's runs; opening them costs MLflow's import, so it is done once per process."""
    return RunStore(paths)


def log_stage(paths: ProjectPaths, stage: StageRun) -> None:
    """Write a finished stage as a run of its own, unless it is there with the same numbers.

    A run that a killed command left unfinished is ended as KILLED.
    """
    runs = run_store(paths)
    metrics = {metric_name(name): value for name, value in stage.metrics.items()}
    for run in runs.find(stage.label, {"stage_key": stage.key, "role": stage.kind}):
        if run.info.status == "FINISHED" and all(run.data.metrics.get(k) == v for k, v in metrics.items()):
            return
        if run.info.status == "RUNNING":
            runs.end(run.info.run_id, "KILLED")
    started_s = time.time() - stage.wall_s if stage.started_s is None else stage.started_s
    tags = {"role": stage.kind, "stage_key": stage.key, NOTE: stage.note, **stage.tags}
    run_id = runs.begin(stage.label, stage.name, tags, start_s=started_s)
    runs.log(run_id, params=stage.params, metrics=metrics)
    at = round(1000.0 * (started_s + stage.wall_s))
    curves = {metric_name(name): curve for name, curve in stage.curves.items()}
    points = [entities.Metric(name, value, at, step) for name in curves for step, value in curves[name]]
    runs.log_points(run_id, points)
    runs.log_files(run_id, stage.figures, "figures")
    runs.log_files(run_id, stage.artifacts)
    if stage.record:
        runs.client.log_dict(run_id, dict(stage.record), "provenance.json")
    runs.end(run_id, "FINISHED", end_s=started_s + stage.wall_s)


def metric_name(name: str) -> str:
    """Return a metric's name without the signs that MLflow refuses: `wall[1].R` becomes `wall_1_.R`."""
    return _REFUSED.sub("_", name)
