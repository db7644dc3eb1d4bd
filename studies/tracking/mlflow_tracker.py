"""MLflow as a tracker: runs and metrics in an SQLite file whose place is always given explicitly.

The durable record of a study is its plain files; what is written here is a view that can be written again.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from simulation.file_lock import FileLock
from studies.paths import size_name
from studies.report.wording import difference_unit
from studies.tracking.mlflow_registry import fetch_champion, register_champion
from studies.tracking.origin import origin_tags
from studies.tracking.quiet_mlflow import Dataset, DatasetInput, InputTag, Metric, Param, Run, RunTag, connect
from studies.tracking.tracker import History, RunStatus, StageRun
from studies.tuning.study_spec import StudySpec, StudySummary
from studies.tuning.trial_record import TrialRecord

N_CURVE_POINTS = 60  # per curve: a trial's curves fit in one call, which MLflow limits to 1,000 metrics
_TERMINAL = ("FINISHED", "FAILED", "KILLED")
_STATUS: dict[str, RunStatus] = {"complete": "FINISHED", "pruned": "KILLED", "failed": "FAILED"}
_CONTEXTS = {"train": "training", "validation": "validation", "test": "testing"}


class MlflowTracker:
    """Writes studies, trials, stages and champions to an MLflow store.

    Args:
        database: SQLite file; created with MLflow's schema where absent.
        artifacts: root folder of all artifacts.
        root: project whose git commit is noted.
    """

    def __init__(self, database: Path, artifacts: Path, *, root: Path | None = None) -> None:
        database.parent.mkdir(parents=True, exist_ok=True)
        artifacts.mkdir(parents=True, exist_ok=True)
        self.uri = f"sqlite:///{database.resolve().as_posix()}"
        self._artifacts = artifacts.resolve()
        # Two processes that make a schema or an experiment at the same moment would get in each other's way.
        self._lock = FileLock(database.with_name(f"{database.name}.lock"))
        with self._lock:
            self.client = connect(self.uri)
        self._origin = origin_tags(root or Path.cwd())
        self._experiments: dict[str, str] = {}
        self._studies: dict[str, str] = {}
        self._trials: dict[str, tuple[str, str]] = {}

    def start_study(self, spec: StudySpec, *, n_trials: int) -> None:
        """Open the study's run, a new one or the one an earlier call left."""
        experiment = self._experiment(spec.label, _experiment_note(spec))
        found = self._search(experiment, {"study_key": spec.name, "role": "study"})
        if found:
            self._studies[spec.name] = found[0].info.run_id
        else:
            run = self.client.create_run(
                experiment,
                run_name=f"{size_name(spec.n_train)} study",
                tags={
                    **self._origin,
                    **_study_tags(spec),
                    "role": "study",
                    "mlflow.note.content": _study_note(spec),
                },
            )
            self._studies[spec.name] = run.info.run_id
            params = {
                "n_train": spec.n_train,
                "variant": spec.variant,
                "seed": spec.seed,
                **spec.shared_settings,
            }
            params |= {f"search.{name}": span for name, span in vars(spec.search).items() if span is not None}
            self.client.log_batch(run.info.run_id, params=_params(params))
            self._log_datasets(run.info.run_id, spec)
        for run in self._search(experiment, {"study_key": spec.name, "role": "trial"}):
            self._trials[run.data.tags["trial_key"]] = (run.info.run_id, run.info.status)
        keys = [key for key in self._trials if key.startswith(f"{spec.name}/")]
        if len(keys) < n_trials:
            self._wake(self._studies[spec.name])

    def log_trial(self, spec: StudySpec, record: TrialRecord, history: Callable[[], History]) -> None:
        """Write a finished trial as a run below its study's, or complete the run an interruption left."""
        run_id, status = self._trials.get(record.key, ("", ""))
        if status in _TERMINAL:
            return
        self._wake(self._studies[spec.name])
        if not run_id:
            tags = {
                **self._origin,
                **_study_tags(spec),
                "role": "trial",
                "trial_key": record.key,
                "state": record.state,
                "reason": record.reason[:4000],
                "mlflow.parentRunId": self._studies[spec.name],
            }
            run_id = self.client.create_run(
                self._experiments[spec.label],
                start_time=_ms(record.started_s),
                run_name=f"{size_name(spec.n_train)} trial {record.index:03d}",
                tags=tags,
            ).info.run_id
        results = {
            **record.metrics,
            "train_wall_s": record.wall_s,
            "n_epochs": record.n_epochs,
            "best_epoch": record.best_epoch,
            "n_rows": record.n_rows,
        }
        end = _ms(record.ended_s)
        metrics = [Metric(name, float(value), end, 0) for name, value in results.items()]
        metrics += _curves(history(), _ms(record.started_s), end)
        settings = {**record.config, "seed": record.seed, "n_train": record.n_train}
        self.client.log_batch(run_id, metrics=metrics, params=_params(settings))
        self._log_datasets(run_id, spec)
        status = _STATUS[record.state]
        self.client.set_terminated(run_id, status, end)
        self._trials[record.key] = (run_id, status)

    def trial_run_id(self, spec: StudySpec, key: str) -> str:
        """Return the id of a trial's run, empty without one."""
        return self._trials.get(key, ("", ""))[0]

    def finish_study(self, spec: StudySpec, summary: StudySummary, status: RunStatus) -> None:
        """Write the best trial's errors on the study's run, for the collapsed list, and end it."""
        run_id = self._studies.get(spec.name)
        if run_id is None:  # interrupted before the study was opened here
            return
        run = self.client.get_run(run_id)
        told = json.dumps([summary.n_trials, summary.best_index])
        if run.info.status == status and run.data.tags.get("told") == told:
            return
        self._wake(run_id)
        now = _ms(time.time())
        counts = {
            "n_complete": summary.n_complete,
            "n_pruned": summary.n_pruned,
            "n_failed": summary.n_failed,
            "train_wall_s": summary.wall_s,
        }
        best = {f"best/{name}": value for name, value in summary.best_metrics.items()}
        metrics = [Metric(k, float(v), now, summary.n_trials) for k, v in {**counts, **best}.items()]
        said = {"told": told, "best_trial": summary.best_index, "n_trials": summary.n_trials}
        said |= {f"best_{name}": summary.best_config.get(name) for name in ("n_latent", "n_hidden", "beta")}
        self.client.log_batch(run_id, metrics=metrics, tags=[RunTag(k, str(v)) for k, v in said.items()])
        self.client.set_terminated(run_id, status)

    def register_champion(self, spec: StudySpec, folder: Path) -> None:
        """Register the champion in its folder under the alias "champion", unless it is there already."""
        run_id = self._studies[spec.name]
        register_champion(
            self.client, spec=spec, folder=folder, run_id=run_id, wake=lambda: self._wake(run_id)
        )

    def fetch_champion(self, label: str, n_train: int, folder: Path) -> bool:
        """Copy the files of the registered champion into an empty folder; return whether there is one."""
        return fetch_champion(
            self.client, label=label, n_train=n_train, artifacts=self._artifacts, folder=folder
        )

    def log_stage(self, stage: StageRun) -> None:
        """Write a stage as a run of its own, or complete the run an interruption left."""
        experiment = self._experiment(stage.label)
        found = self._search(experiment, {"stage_key": stage.key, "role": stage.kind})
        if any(run.info.status in _TERMINAL and run.data.tags.get("whole") == "yes" for run in found):
            return
        start = _ms(stage.started_s if stage.started_s is not None else time.time() - stage.wall_s)
        end = start + round(1000 * stage.wall_s)
        if found:
            run_id = found[0].info.run_id
        else:
            tags = {"role": stage.kind, "stage_key": stage.key, "label": stage.label, **stage.tags}
            tags |= {"mlflow.note.content": stage.note} if stage.note else {}
            run_id = self.client.create_run(
                experiment,
                start_time=start,
                run_name=stage.name,
                tags={**self._origin, **{name: str(value) for name, value in tags.items()}},
            ).info.run_id
        self.client.log_batch(run_id, params=_params(stage.params))
        metrics = [Metric(name, float(value), end, 0) for name, value in stage.metrics.items()]
        for name, curve in stage.curves.items():
            metrics += [Metric(name, float(value), end, int(step)) for step, value in _thinned(curve)]
        for first in range(0, len(metrics), 1000):
            self.client.log_batch(run_id, metrics=metrics[first : first + 1000])
        for file in stage.figures:
            self.client.log_artifact(run_id, str(file), "figures")
        for file in stage.artifacts:
            self.client.log_artifact(run_id, str(file))
        self.client.set_tag(run_id, "whole", "yes")
        self.client.set_terminated(run_id, stage.status, end)

    def _experiment(self, label: str, note: str = "") -> str:
        if label not in self._experiments:
            with self._lock:
                self._experiments[label] = self._found_or_made(label)
        if note:
            self.client.set_experiment_tag(self._experiments[label], "mlflow.note.content", note)
        return self._experiments[label]

    def _found_or_made(self, label: str) -> str:
        found = self.client.get_experiment_by_name(label)
        if found is None:
            return self.client.create_experiment(label, (self._artifacts / label).as_uri())
        if found.lifecycle_stage == "deleted":
            self.client.restore_experiment(found.experiment_id)
        return found.experiment_id

    def _search(self, experiment: str, tags: Mapping[str, str]) -> list[Run]:
        wanted = " and ".join(f"tags.{name} = '{value}'" for name, value in tags.items())
        found: list[Run] = []
        token = None
        while True:
            page = self.client.search_runs(
                [experiment], wanted, order_by=["attributes.start_time ASC"], page_token=token
            )
            found += page
            token = page.token
            if not token:
                return found

    def _wake(self, run_id: str) -> None:
        if self.client.get_run(run_id).info.status != "RUNNING":
            self.client.update_run(run_id, status="RUNNING")

    def _log_datasets(self, run_id: str, spec: StudySpec) -> None:
        inputs = []
        for name, context in _CONTEXTS.items():
            source = json.dumps({"file": getattr(spec, f"{name}_file").name})
            dataset = Dataset(f"{spec.case_name} {name}", spec.digests[name][:32], "local", source)
            inputs.append(DatasetInput(dataset, [InputTag("mlflow.data.context", context)]))
        self.client.log_inputs(run_id, inputs)


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


def _experiment_note(spec: StudySpec) -> str:
    unit = difference_unit(spec.output_unit)
    lines = [
        f"PELS-VAE surrogates of the case **{spec.case_name}**: a study (parent run) per training-set size,",
        f"a run per trial below it. `val/mae` and `test/mae` are mean absolute errors in {unit}, `p90` the",
        "90th percentile over simulations; `best/...` on a study is its best trial by validation error.",
        "States: FINISHED complete, KILLED pruned or interrupted, FAILED with its `reason` as a tag.",
    ]
    return " ".join(lines) + (f"\n\n{spec.note}" if spec.note else "")


def _study_note(spec: StudySpec) -> str:
    return (
        f"Surrogates trained on the first {spec.n_train} simulations of the design, searched from the "
        f"variant `{spec.variant}`. Optuna study `{spec.name}`."
    )


def _params(values: Mapping[str, Any]) -> list[Param]:
    return [Param(name, str(value)[:6000]) for name, value in values.items()]


def _curves(history: History, start_ms: int, end_ms: int) -> list[Metric]:
    epochs = [int(epoch) for epoch in history.get("epoch", [])]
    points = []
    for name, curve in history.items():
        if name != "epoch":
            for epoch, value in _thinned(list(zip(epochs, map(float, curve), strict=True))):
                at = start_ms + round((end_ms - start_ms) * epoch / epochs[-1])
                points.append(Metric(f"curve/{name}", value, at, epoch))
    return points


def _thinned(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """Keep so many points of a curve that a chart of it looks the same, its ends among them."""
    if len(curve) <= N_CURVE_POINTS:
        return list(curve)
    last = len(curve) - 1
    kept = sorted({round(i * last / (N_CURVE_POINTS - 1)) for i in range(N_CURVE_POINTS)})
    return [curve[i] for i in kept]


def _ms(seconds: float) -> int:
    return round(1000.0 * seconds)
