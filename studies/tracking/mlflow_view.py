"""Views of MLflow's page of runs: which rows, columns and charts it opens with, and the addresses that do so.

MLflow keeps a view as a tag of the experiment. The format is its own and may change: a page that cannot read
a view shows its default columns instead.
"""

import hashlib
import json
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote, urlencode

LEADERBOARD, TRIALS, STAGES = "leaderboard", "trials", "stages"
SHARED_VIEW = "mlflow.sharedViewState."
ON_BOARD = "leaderboard"
"""Tag of the runs that the leaderboard lists."""

_MADE_MS = 1_767_225_600_000  # a view is no news: the same one has the same bytes
_Chart = dict[str, Any]


def view_tags() -> dict[str, str]:
    """Return the tags of an experiment that hold its views."""
    views = {LEADERBOARD: _leaderboard(), TRIALS: _trials(), STAGES: _stages()}
    return {f"{SHARED_VIEW}{key}": view for key, view in views.items()}


def view_address(experiment_id: str, view: str, *, charts: bool = False) -> str:
    """Return the end of the address that opens an experiment in one of its views."""
    query = {"workflowType": "machine_learning", "viewStateShareKey": view}
    if charts:
        query["compareRunsMode"] = "CHART"
    return f"#/experiments/{experiment_id}/runs?{urlencode(query)}"


def run_address(experiment_id: str, run_id: str, *, artifact: str = "") -> str:
    """Return the end of the address of a run's page, or of one of its files."""
    where = f"/artifacts/{quote(artifact)}" if artifact else ""
    return f"#/experiments/{experiment_id}/runs/{run_id}{where}?workflowType=machine_learning"


def picture_address(run_id: str, file: str, *, version: str) -> str:
    """Return where a page of MLflow finds a run's picture; a new version is not taken from the cache."""
    return f"get-artifact?{urlencode({'path': file, 'run_uuid': run_id, 'v': version})}"


def _leaderboard() -> str:
    """One row per training-set size, and one for all; charts of what each size is good for."""
    columns = {
        _metric("n_train"): 75,
        _metric("best/test/mae"): 120,
        _metric("best/test/p90"): 120,
        _metric("default/test/mae"): 135,
        _metric("gain_percent"): 112,
        _metric("n_trials"): 78,
        _metric("n_pruned"): 88,
        _metric("tuning_h"): 88,
        _metric("calibrated/mse"): 120,
        _metric("calibrated/calls"): 125,
    }
    charts = [
        _scatter("Mean absolute error over n", "n_train", "best/test/mae"),
        _scatter("90th percentile over n", "n_train", "best/test/p90"),
        _scatter("What tuning gained over the default configuration [%]", "n_train", "gain_percent"),
        _scatter("Hours of training", "n_train", "tuning_h"),
        _scatter("MSE of the calibrated model over n", "n_train", "calibrated/mse"),
        _scatter("Model calls in all over n", "n_train", "calibrated/calls"),
    ]
    return _view("Leaderboard: the best model per n", f"tags.{ON_BOARD} = 'yes'", columns, charts)


def _stages() -> str:
    """What is neither study nor trial: calibrations, sensitivities, reports."""
    columns = {
        "tags.`role`": 110,
        _metric("n_train"): 80,
        _metric("mse/polished"): 125,
        _metric("mse/calibrated"): 125,
        _metric("mse/screened"): 125,
        _metric("mse/validation"): 125,
        _metric("calls/all"): 85,
        _metric("calls/paper"): 95,
    }
    charts = [
        {
            **_chart("LINE", "Least MSE over model calls"),
            "metricKey": "mse/over_calls",
            "selectedMetricKeys": ["mse/over_calls"],
            "scaleType": "log",
            "xAxisKey": "step",
            "lineSmoothness": 0,
        },
        _scatter("MSE over n", "n_train", "mse/polished"),
    ]
    rows = "tags.role != 'trial' and tags.role != 'study' and tags.role != 'overview'"
    return _view("Calibrations, sensitivities, reports", rows, columns, charts)


def _trials() -> str:
    """All trials with their errors and hyperparameters."""
    names = ("n_latent", "n_hidden", "beta", "learning_rate", "n_scales", "degree")
    columns = {
        "tags.`state`": 90,
        "tags.`origin`": 110,
        _metric("n_train"): 80,
        _metric("val/mae"): 100,
        _metric("test/mae"): 100,
        _metric("test/p90"): 100,
        **{f"params.`{name}`": 105 for name in names},
        _metric("n_epochs"): 90,
        _metric("train_wall_s"): 110,
    }
    parallel = {
        **_chart("PARALLEL", "Hyperparameters and error, one line per trial"),
        "selectedParams": ["n_train", *names],
        "selectedMetrics": ["val/mae"],
        "showAllRuns": True,
    }
    curves = {
        **_chart("LINE", "Validation error over epochs"),
        "metricKey": "curve/validation_mae",
        "selectedMetricKeys": ["curve/validation_mae"],
        "scaleType": "log",
        "xAxisKey": "step",
        "lineSmoothness": 0,
    }
    charts = [
        _scatter("Mean absolute error over n (Fig. 6: all trials)", "n_train", "test/mae"),
        _scatter("90th percentile over n (all trials)", "n_train", "test/p90"),
        parallel,
        curves,
    ]
    return _view("All trials", "tags.role = 'trial'", columns, charts)


def _view(name: str, rows: str, columns: dict[str, int], charts: Sequence[_Chart]) -> str:
    section = {"uuid": _uuid(name), "name": name, "display": True, "isReordered": True, "isGenerated": False}
    state = {
        "searchFilter": rows,
        "orderByKey": "tags.`mlflow.runName`",
        "orderByAsc": True,
        "startTime": "ALL",
        "lifecycleFilter": "Active",
        "datasetsFilter": [],
        "modelVersionFilter": "All Runs",
        "selectedColumns": list(columns),
        "columnOrder": list(columns),
        "columnWidths": columns,
        "compareRunCharts": [{**chart, "metricSectionId": section["uuid"]} for chart in charts],
        "compareRunSections": [section],
        "isAccordionReordered": True,
        "runsHiddenMode": "SHOWALL",
        "hideEmptyCharts": True,
        "autoRefreshEnabled": True,
    }
    content = {"name": name, "createdAt": _MADE_MS, "updatedAt": _MADE_MS, "state": json.dumps(state)}
    return json.dumps(content)


def _chart(kind: str, title: str) -> _Chart:
    return {
        "uuid": _uuid(title),
        "type": kind,
        "displayName": title,
        "runsCountToCompare": 500,
        "deleted": False,
        "isGenerated": False,
    }


def _scatter(title: str, x: str, y: str) -> _Chart:
    return {
        **_chart("SCATTER", title),
        "xaxis": {"key": x, "type": "METRIC"},
        "yaxis": {"key": y, "type": "METRIC"},
    }


def _metric(name: str) -> str:
    return f"metrics.`{name}`"


def _uuid(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
