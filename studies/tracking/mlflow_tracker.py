"""MLflow as a tracker: what a study tells, written as runs, metrics, pictures and models.

The durable record of a study is elsewhere; what is written here is a view that can be written again, by any
machine: a trial's run is found by its key under the study's lock, so that two machines never make two.
"""

import json
import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from studies.paths import ProjectPaths, size_name
from studies.recipe import memory_tags
from studies.report.wording import difference_unit
from studies.tracking.mlflow_datasets import dataset_inputs
from studies.tracking.mlflow_notes import best_sentence, study_note, study_numbers
from studies.tracking.mlflow_overview import NOTE, OverviewClock, update_overview
from studies.tracking.mlflow_registry import fetch_champion, register_champion
from studies.tracking.mlflow_runs import TERMINAL, RunStore, curve_points, ms, params, thinned
from studies.tracking.mlflow_view import ON_BOARD, run_address, view_tags
from studies.tracking.quiet_mlflow import Metric, Run, RunTag
from studies.tracking.tracker import History, RunStatus, StageRun
from studies.tuning.study_spec import StudySpec, StudySummary
from studies.tuning.trial_record import TrialRecord

_STATUS: dict[str, RunStatus] = {"complete": "FINISHED", "pruned": "KILLED", "failed": "FAILED"}


class MlflowTracker:
    """Writes studies, trials, stages and champions to a project's MLflow store.

    Args:
        paths: the project.
    """

    def __init__(self, paths: ProjectPaths) -> None:
        self.runs = RunStore(paths)
        self.client = self.runs.client
        self._paths = paths
        self._studies: dict[str, str] = {}
        self._trials: dict[str, tuple[str, str]] = {}
        self._told: dict[str, dict[int, tuple[TrialRecord, Callable[[], History]]]] = {}
        self._clock = OverviewClock()

    def start_study(self, spec: StudySpec, *, n_trials: int) -> None:
        """Open the study's run, a new one or the one an earlier call or another machine made."""
        self._told.setdefault(spec.name, {})
        self.runs.describe(spec.label, view_tags())
        with self.runs.lock(spec.name):
            found = self.runs.find(spec.label, {"study_key": spec.name, "role": "study"})
            self._studies[spec.name] = found[0].info.run_id if found else self._make_study(spec)
            self._prefer(spec)
            self._drop_twins(spec)
        if sum(key.startswith(f"{spec.name}/") for key in self._trials) < n_trials:
            self.runs.wake(self._studies[spec.name])

    def log_trial(self, spec: StudySpec, record: TrialRecord, history: Callable[[], History]) -> None:
        """Write a finished trial as a run below its study's, or complete the run an interruption left."""
        if spec.name not in self._studies:  # the store was away when the study began
            self.start_study(spec, n_trials=record.index + 1)
        self._told[spec.name][record.index] = (record, history)
        if self._trials.get(record.key, ("", ""))[1] in TERMINAL:
            return
        self.runs.wake(self._studies[spec.name])
        with self.runs.lock(spec.name):
            found = self.runs.find(spec.label, {"trial_key": record.key})
            run_id = found[0].info.run_id if found else self._make_trial(spec, record)
            status = self.runs.status_of(found[0]) if found else "RUNNING"
            if status not in TERMINAL:
                status = self._complete_trial(run_id, record, history())
        self._trials[record.key] = (run_id, status)
        self._show_progress(spec.label)

    def trial_run_id(self, spec: StudySpec, key: str) -> str:
        """Return the id of a trial's run, empty without one."""
        return self._trials.get(key, ("", ""))[0]

    def finish_study(self, spec: StudySpec, summary: StudySummary, status: RunStatus) -> None:
        """Write the best trial's errors on the study's run, for the leaderboard, draw it, and end it."""
        run_id = self._studies.get(spec.name)
        if run_id is None:  # interrupted before the study was opened here
            return
        run = self.client.get_run(run_id)
        told = json.dumps([summary.n_trials, summary.best_index])
        if run.info.status == status and run.data.tags.get("told") == told:
            return
        default = self._default_error(spec)
        now = ms(time.time())
        numbers = study_numbers(summary, default)
        metrics = [Metric(name, value, now, summary.n_trials) for name, value in numbers.items()]
        self.client.log_batch(run_id, metrics=metrics)
        pictures = self._draw(spec, run_id) if status == "FINISHED" else []
        said: dict[str, Any] = {"best_trial": summary.best_index, "n_trials": summary.n_trials}
        said |= {f"best_{name}": summary.best_config.get(name) for name in spec.search.names}
        if summary.best_index is not None:
            page, words = self.runs.experiment(spec.label), str.maketrans("_", " ")
            places = {
                Path(file).stem.translate(words): run_address(page, run_id, artifact=file)
                for file in pictures
            }
            said[NOTE] = study_note(spec, best_sentence(summary, default, spec.output_unit), places)
        self.client.log_batch(run_id, tags=[RunTag(name, str(value)) for name, value in said.items()])
        self.client.set_tag(run_id, "told", told)
        self.runs.finish(run_id, status)
        update_overview(self.runs, spec.label)

    def register_champion(self, spec: StudySpec, folder: Path) -> None:
        """Register the champion in its folder under the alias "champion", unless it is there already."""
        run_id = self._studies.get(spec.name)
        if run_id is not None and self.runs.reaches_artifacts(spec.label):
            with self.runs.lock(spec.name):
                register_champion(
                    self.client, spec=spec, folder=folder, run_id=run_id, wake=lambda: self.runs.wake(run_id)
                )

    def fetch_champion(self, label: str, n_train: int, folder: Path) -> bool:
        """Copy the files of the registered champion into an empty folder; return whether there is one."""
        return fetch_champion(
            self.client, label=label, n_train=n_train, artifacts=self.runs.artifacts, folder=folder
        )

    def log_stage(self, stage: StageRun) -> None:
        """Write a stage as a run of its own, or complete the run an interruption left.

        A stage that came to other numbers when it was done again is another run.
        """
        with self.runs.lock(f"{stage.label}/{stage.kind}"):
            found = self.runs.find(stage.label, {"stage_key": stage.key, "role": stage.kind})
            whole = [r for r in found if r.info.status in TERMINAL and r.data.tags.get("whole") == "yes"]
            if any(_tells(run, stage) for run in whole):
                return
            begun = [run for run in found if run not in whole]
            start = ms(stage.started_s if stage.started_s is not None else time.time() - stage.wall_s)
            end = start + round(1000 * stage.wall_s)
            if begun:
                run_id = begun[0].info.run_id
            else:
                tags = {"role": stage.kind, "stage_key": stage.key, "label": stage.label, **stage.tags}
                tags |= {NOTE: stage.note} if stage.note else {}
                run_id = self.runs.create(stage.label, stage.name, tags, start_ms=start)
            self._write_stage(run_id, stage, end)
            self.client.set_tag(run_id, "whole", "yes")
            self.runs.finish(run_id, stage.status, end)
        if stage.kind == "calibration":
            update_overview(self.runs, stage.label)

    def end_ghosts(self) -> list[str]:
        """End the runs whose process is no more; return their names."""
        return self.runs.end_ghosts()

    def _write_stage(self, run_id: str, stage: StageRun, end: int) -> None:
        self.client.log_batch(run_id, params=params(stage.params))
        numbers = dict(stage.metrics)
        if "n_train" in stage.tags:
            numbers["n_train"] = float(stage.tags["n_train"])
        metrics = [Metric(name, float(value), end, 0) for name, value in numbers.items()]
        for name, curve in stage.curves.items():
            points = thinned(curve)
            metrics += [Metric(name, float(value), end, int(step)) for step, value in points]
        for first in range(0, len(metrics), 1000):
            self.client.log_batch(run_id, metrics=metrics[first : first + 1000])
        if not self.runs.reaches_artifacts(stage.label):
            return
        for file in stage.figures:
            self.client.log_artifact(run_id, str(file), "figures")
        for file in stage.artifacts:
            self.client.log_artifact(run_id, str(file))
        self._log_json(run_id, {"recipe.json": stage.recipe, "environment.json": stage.environment})

    def _make_study(self, spec: StudySpec) -> str:
        tags = {
            **_study_tags(spec),
            "role": "study",
            "opened_s": time.time(),
            "error_unit": difference_unit(spec.output_unit),
            "case_note": spec.note,
            NOTE: study_note(spec),
            **memory_tags(recipe=spec.recipe),
        }
        run_id = self.runs.create(spec.label, f"{size_name(spec.n_train)} study", tags)
        settings = {
            "n_train": spec.n_train,
            "variant": spec.variant,
            "seed": spec.seed,
            **spec.shared_settings,
        }
        settings |= {f"search.{name}": span for name, span in vars(spec.search).items() if span is not None}
        self.client.log_batch(run_id, params=params(settings))
        self.client.log_inputs(run_id, dataset_inputs(spec, show=self._paths.show))
        if self.runs.reaches_artifacts(spec.label):
            self._log_json(run_id, {"recipe.json": spec.recipe})
        return run_id

    def _prefer(self, spec: StudySpec) -> None:
        """Make a study the one that counts for its size, where several of different settings exist."""
        same_size = self.runs.find(spec.label, {"role": "study", "n_train": str(spec.n_train)})
        newest = max(same_size, key=lambda run: float(run.data.tags.get("opened_s", 0.0)))
        if newest.info.run_id != self._studies[spec.name]:
            self.client.set_tag(self._studies[spec.name], "opened_s", str(time.time()))
        for run in same_size:
            is_ours = "yes" if run.info.run_id == self._studies[spec.name] else "no"
            if run.data.tags.get(ON_BOARD) != is_ours:
                self.client.set_tag(run.info.run_id, ON_BOARD, is_ours)

    def _drop_twins(self, spec: StudySpec) -> None:
        """Learn which trials have a run, and remove the younger one of two, whoever made it."""
        for run in self.runs.find(spec.label, {"study_key": spec.name, "role": "trial"}):
            key = run.data.tags["trial_key"]
            if key in self._trials and self._trials[key][0] != run.info.run_id:
                self.client.delete_run(run.info.run_id)
            else:
                self._trials[key] = (run.info.run_id, self.runs.status_of(run))

    def _make_trial(self, spec: StudySpec, record: TrialRecord) -> str:
        tags = {
            **_study_tags(spec),
            "role": "trial",
            "trial_key": record.key,
            "state": record.state,
            "reason": record.reason[:4000],
            "origin": record.origin,
            "environment": json.dumps(record.environment),
            "mlflow.parentRunId": self._studies[spec.name],
            **memory_tags(record=asdict(record)),
        }
        name = f"{size_name(spec.n_train)} trial {record.index:03d}"
        return self.runs.create(spec.label, name, tags, start_ms=ms(record.started_s))

    def _complete_trial(self, run_id: str, record: TrialRecord, history: History) -> str:
        results = {
            **record.metrics,
            "n_train": record.n_train,
            "train_wall_s": record.wall_s,
            "n_epochs": record.n_epochs,
            "best_epoch": record.best_epoch,
            "n_rows": record.n_rows,
        }
        start, end = ms(record.started_s), ms(record.ended_s)
        metrics = [Metric(name, float(value), end, 0) for name, value in results.items()]
        metrics += curve_points(history, start, end)
        settings = {**record.config, "seed": record.seed, "n_train": record.n_train}
        self.client.log_batch(run_id, metrics=metrics, params=params(settings))
        self.runs.finish(run_id, _STATUS[record.state], end)
        return _STATUS[record.state]

    def _default_error(self, spec: StudySpec) -> float:
        told = [record for record, _ in self._told.get(spec.name, {}).values() if record.origin == "default"]
        return told[0].metrics.get("test/mae", float("nan")) if told else float("nan")

    def _draw(self, spec: StudySpec, run_id: str) -> list[str]:
        """Draw what was told of a study; return the pictures' places among its run's artifacts."""
        from studies.tracking.search_pictures import draw_search

        told = self._told.get(spec.name, {})
        if not told or not self.runs.reaches_artifacts(spec.label):
            return []
        records = [told[index][0] for index in sorted(told)]
        with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
            histories = {index: history for index, (_, history) in told.items()}
            files = draw_search(spec, records, histories, Path(scratch))
            for file in files:
                self.client.log_artifact(run_id, str(file), "figures")
        return [f"figures/{file.name}" for file in files]

    def _show_progress(self, label: str) -> None:
        if self._clock.is_due:
            started = time.monotonic()
            update_overview(self.runs, label)
            self._clock.took(time.monotonic() - started)

    def _log_json(self, run_id: str, contents: Mapping[str, Mapping[str, Any]]) -> None:
        for name, content in contents.items():
            if content:
                text = json.dumps(content, indent=1, sort_keys=True, default=str)
                self.client.log_text(run_id, text, name)


def _study_tags(spec: StudySpec) -> dict[str, str]:
    digests = {f"{name}_sha256": digest for name, digest in spec.digests.items()}
    return {
        "study_key": spec.name,
        "label": spec.label,
        "case": spec.case_name,
        "n_train": str(spec.n_train),
        "variant": spec.variant,
        "study_seed": str(spec.seed),
        **digests,
    }


def _tells(run: Run, stage: StageRun) -> bool:
    """Say whether a run has a stage's results."""
    numbers = {name: float(value) for name, value in stage.metrics.items()}
    told = run.data.metrics
    return all(told.get(name) == value for name, value in numbers.items() if math.isfinite(value))
