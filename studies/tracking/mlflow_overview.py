"""The overview of an experiment: which model is best for which n, was it worth it; in words and as Fig. 6."""

import hashlib
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from studies.report.records_tuning import TrialsRecord
from studies.tracking.mlflow_notes import SizeResult, experiment_note, overview_note, rounded
from studies.tracking.mlflow_runs import RunStore, ms
from studies.tracking.mlflow_view import ON_BOARD, picture_address
from studies.tracking.quiet_mlflow import Metric, Run

OVERVIEW = "overview"
NAME = "all sizes"
PICTURE = "mae_over_n.png"
NOTE = "mlflow.note.content"

_STATES = ("complete", "pruned", "failed")


def update_overview(store: RunStore, label: str) -> str:
    """Bring an experiment's description, its overview run and the picture of all trials up to date.

    Args:
        store: the runs.
        label: the experiment's name.

    Returns:
        The overview run's id.
    """
    studies = _newest_studies(store.find(label, {"role": "study"}))
    trials = [
        run for run in store.find(label, {"role": "trial"}) if run.data.tags.get("study_key") in studies
    ]
    calibrations = store.find(label, {"role": "calibration"}, newest_first=True)
    sizes = _sizes(studies, trials, calibrations)
    said = next(iter(studies.values())).data.tags if studies else {}
    unit, case, note = (said.get(name, "") for name in ("error_unit", "case", "case_note"))
    experiment = store.experiment(label)
    with store.lock(f"{label}/{OVERVIEW}"):
        found = store.find(label, {"role": OVERVIEW})
        tags = {"role": OVERVIEW, "label": label, ON_BOARD: "yes"}
        run_id = found[0].info.run_id if found else store.create(label, NAME, tags)
        before = found[0].data.tags if found else {}
        drawn = _digest(trials)
        if trials and before.get("drawn") != drawn and store.reaches_artifacts(label):
            _draw(store, run_id, studies, trials, unit=unit, footnote=label)
            store.client.set_tag(run_id, "drawn", drawn)
            before = {**before, "drawn": drawn}
        picture = picture_address(run_id, PICTURE, version=drawn) if "drawn" in before else ""
        text = overview_note(sizes, unit=unit, experiment=experiment)
        if before.get(NOTE) != text:
            store.client.set_tag(run_id, NOTE, text)
            _log_totals(store, run_id, sizes)
            _log_calibrations(store, sizes, studies)
        if not found or found[0].info.status != "FINISHED":
            store.finish(run_id, "FINISHED")
    describing = experiment_note(
        text, picture=picture, unit=unit, case=case, note=note, experiment=experiment
    )
    store.describe(label, {NOTE: describing, "mlflow.experimentKind": "custom_model_development"})
    return str(run_id)


def _log_totals(store: RunStore, run_id: str, sizes: Sequence[SizeResult]) -> None:
    numbers = {
        "n_trials": sum(size.n_trials for size in sizes),
        "n_pruned": sum(size.n_pruned for size in sizes),
        "tuning_h": round(sum(size.tuning_h for size in sizes), 4),
    }
    now = ms(time.time())
    store.client.log_batch(run_id, metrics=[Metric(k, float(v), now, 0) for k, v in numbers.items()])


def _log_calibrations(store: RunStore, sizes: Sequence[SizeResult], studies: Mapping[str, Run]) -> None:
    """Write on each study what the newest calibration with its best surrogate came to, for the leaderboard.

    What an earlier best surrogate's came to becomes NaN.
    """
    now = ms(time.time())
    for size, study in zip(sizes, studies.values(), strict=True):
        numbers = {"calibrated/mse": rounded(size.mse), "calibrated/calls": size.n_calls}
        told = study.data.metrics
        metrics = [Metric(k, v, now, 0) for k, v in numbers.items() if math.isfinite(v) or k in told]
        if metrics:
            store.client.log_batch(size.run_id, metrics=metrics)


def _newest_studies(found: Sequence[Run]) -> dict[str, Run]:
    """Return the study of each size that was opened last, by its key, smallest size first."""
    newest: dict[int, Run] = {}
    for run in sorted(found, key=lambda run: float(run.data.tags.get("opened_s", 0.0))):
        newest[int(run.data.tags["n_train"])] = run
    return {newest[n].data.tags["study_key"]: newest[n] for n in sorted(newest)}


def _sizes(
    studies: Mapping[str, Run], trials: Sequence[Run], calibrations: Sequence[Run]
) -> list[SizeResult]:
    return [
        _size(run, [t for t in trials if t.data.tags["study_key"] == key], calibrations)
        for key, run in studies.items()
    ]


def _size(study: Run, trials: Sequence[Run], calibrations: Sequence[Run]) -> SizeResult:
    """Put together what is known of one size, from its trials: its study may still be running."""
    best, default = best_run(trials), default_run(trials)
    states = [run.data.tags.get("state") for run in trials]
    calibration = next((run for run in calibrations if _is_of(run, study)), None)
    return SizeResult(
        n_train=int(study.data.tags["n_train"]),
        run_id=study.info.run_id,
        status=study.info.status,
        best_run_id=best.info.run_id if best else "",
        best_trial=best.data.tags["trial_key"].rpartition("/t")[2] if best else "",
        validation_mae=_metric(best, "val/mae"),
        test_mae=_metric(best, "test/mae"),
        test_p90=_metric(best, "test/p90"),
        default_mae=_metric(default, "test/mae"),
        n_trials=len(trials),
        n_pruned=states.count("pruned"),
        n_failed=states.count("failed"),
        tuning_h=sum(_metric(run, "train_wall_s", 0.0) for run in trials) / 3600.0,
        calibration_run_id=calibration.info.run_id if calibration else "",
        mse=_metric(calibration, "mse/polished"),
        n_calls=_metric(calibration, "calls/all"),
    )


def _is_of(calibration: Run, study: Run) -> bool:
    """Say whether a calibration is written whole, of all parameters and with a study's best surrogate."""
    tags, wanted = calibration.data.tags, study.data.tags
    used = tags.get("surrogate_study"), tags.get("surrogate_trial")
    is_ours = used == (wanted["study_key"], wanted.get("best_trial"))
    return is_ours and "whole" in tags and "n_free" not in tags


def best_run(trials: Sequence[Run]) -> Run | None:
    """Return the completed trial of least validation error."""
    complete = [run for run in trials if run.data.tags.get("state") == "complete"]
    judged = [run for run in complete if math.isfinite(_metric(run, "val/mae"))]
    return min(judged, key=lambda run: (_metric(run, "val/mae"), run.info.run_name), default=None)


def default_run(trials: Sequence[Run]) -> Run | None:
    """Return the trial that trained the default configuration."""
    return next((run for run in trials if run.data.tags.get("origin") == "default"), None)


def _metric(run: Run | None, name: str, otherwise: float = math.nan) -> float:
    return float(run.data.metrics.get(name, otherwise)) if run is not None else math.nan


def _digest(trials: Sequence[Run]) -> str:
    keys = sorted(f"{run.data.tags['trial_key']} {run.info.status}" for run in trials)
    return hashlib.sha256("\n".join(keys).encode()).hexdigest()[:16]


def _draw(
    store: RunStore,
    run_id: str,
    studies: Mapping[str, Run],
    trials: Sequence[Run],
    *,
    unit: str,
    footnote: str,
) -> None:
    from studies.report.figures_tuning import mae_over_n_figure

    shown = [run for run in trials if run.data.tags.get("state") in _STATES]
    best = {
        run.info.run_id
        for key in studies
        if (run := best_run([t for t in shown if t.data.tags["study_key"] == key]))
    }

    def metric(name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.array([_metric(run, name) for run in shown], dtype=np.float64)

    record = TrialsRecord(
        n_train=np.array([int(run.data.tags["n_train"]) for run in shown], dtype=np.int64),
        state=tuple(run.data.tags["state"] for run in shown),
        validation_mae=metric("val/mae"),
        test_mae=metric("test/mae"),
        test_p90=metric("test/p90"),
        is_best=np.array([run.info.run_id in best for run in shown]),
    )
    with tempfile.TemporaryDirectory(prefix="studies-overview-") as scratch:
        drawn = mae_over_n_figure(record, Path(scratch) / PICTURE, unit=unit, footnote=footnote)
        store.client.log_artifact(run_id, str(drawn))


class OverviewClock:
    """Says when an overview is due while trials come in, so that it takes a small share of the time."""

    SHARE = 0.02
    LEAST_S = 60.0

    def __init__(self) -> None:
        self._due = time.monotonic() + self.LEAST_S

    @property
    def is_due(self) -> bool:
        """Whether enough time has passed."""
        return time.monotonic() >= self._due

    def took(self, wall_s: float) -> None:
        """Hear how long an update took. [s]."""
        self._due = time.monotonic() + max(self.LEAST_S, wall_s / self.SHARE)
