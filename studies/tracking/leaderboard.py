"""Two views of MLflow's page of runs, with our columns and charts, kept as tags of an experiment.

MLflow has no interface for them: the form of the tags is its own. A page that cannot read one shows
its usual columns.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

if TYPE_CHECKING:
    from studies.tracking.runs import RunStore

SHARED_VIEW = "mlflow.sharedViewState."
"""Of MLflow's: what `viewStateShareKey` of an address names."""
TABLE, CHARTS = "leaderboard", "charts"
GAIN = "gain"
"""Metric of the best trial's run: part of the default configuration's validation error that tuning took."""
_FIRST = ("n_latent", "n_hidden", "beta")  # what every reader of the paper looks for
JUDGED_BY = "judged_by"
"""Parameter of a study run: first part of the names of the errors that are shown of its trials."""
SEARCHED = "search."
"""Begins the names of a study run's parameters that hold its search space."""
_RUN_NAME, _DATE = "attributes.`Run Name`", "runDateAndNestInfo"
_MOST_RUNS = 1000  # that a chart shows
_Chart = dict[str, Any]


def page_of(experiment_id: str, view: str | None) -> str:
    """Return the end of the address of an experiment's runs, in one of its views."""
    query = {"workflowType": "machine_learning"}
    if view is not None:
        query |= {"viewStateShareKey": view}
    if view == CHARTS:
        query |= {"compareRunsMode": "CHART"}
    return f"#/experiments/{experiment_id}/runs?{urlencode(query)}"


def set_views(
    runs: "RunStore", label: str, searched: Iterable[str] = (), judged_by: str | None = None
) -> None:
    """Bring the views of a label's experiment up to date with what its studies search.

    Args:
        runs: the project's runs.
        label: whose experiment.
        searched: hyperparameters that a study about to begin searches.
        judged_by: first part of the names of the errors that are shown; None for that of the last study.
    """
    studies = runs.find(label, {"role": "study"})
    known = [name for run in reversed(studies) for name in run.data.params if name.startswith(SEARCHED)]
    names = dict.fromkeys([*searched, *(name.removeprefix(SEARCHED) for name in known)])
    judged_by = judged_by or next((run.data.params.get(JUDGED_BY) for run in reversed(studies)), None)
    experiment = runs.client.get_experiment(runs.experiment(label))
    for name, view in views_of([*names], judged_by or "test").items():
        # A tag that is set anew makes the experiment the one that was worked on last.
        if experiment.tags.get(name) != view:
            runs.client.set_experiment_tag(experiment.experiment_id, name, view)


def views_of(searched: Sequence[str], judged_by: str = "test") -> dict[str, str]:
    """Return the views as tags of an experiment.

    Args:
        searched: hyperparameters that its studies search.
        judged_by: first part of the names of the errors that are shown.
    """
    mae, p90 = f"{judged_by}/mae", f"{judged_by}/p90"
    # As narrow as their titles: at the first visit MLflow's "Assistant" takes a quarter of the page.
    columns = {_RUN_NAME: 100, _DATE: 34, _metric(mae): 74, _metric(p90): 74}
    columns |= {_param("n_train"): 70, **{_param(name): 76 for name in _FIRST}, _metric(GAIN): 58}
    columns |= {_param(name): 90 for name in ("decoder", *searched) if name not in _FIRST}
    if judged_by == "test":
        columns[_metric("val/mae")] = 74
    over_n = [
        _scatter("MAE over n (Fig. 6)", "n_train", mae),
        _scatter("90th percentile over n (Fig. 6)", "n_train", p90),
    ]
    parallel = {
        **_chart("PARALLEL", "Hyperparameters and MAE of each trial"),
        "selectedParams": ["n_train", *searched],
        "selectedMetrics": [mae],
        "showAllRuns": True,
    }
    over_each = [_scatter(f"MAE over {name}", name, mae) for name in searched]
    # The least error first; by n_train MLflow would sort texts, 128 before 32.
    states = {
        TABLE: _view("tags.best = 'yes'", _metric(mae), columns, []),
        CHARTS: _view("tags.role = 'trial'", _metric(mae), columns, [*over_n, parallel, *over_each]),
    }
    return {f"{SHARED_VIEW}{name}": json.dumps(state) for name, state in states.items()}


def _view(rows: str, first: str, columns: Mapping[str, int], charts: Sequence[_Chart]) -> dict[str, Any]:
    """Return a view: which rows it has, by what they rise, its columns and their widths, its charts."""
    section = {"uuid": "trials", "name": "Trials", "display": True, "isReordered": True}
    section |= {"isGenerated": False, "columns": 3}
    return {
        "searchFilter": rows,
        "orderByKey": first,
        "orderByAsc": True,
        "selectedColumns": list(columns),
        "columnOrder": list(columns),
        "columnWidths": dict(columns),
        "compareRunCharts": [{**chart, "metricSectionId": section["uuid"]} for chart in charts],
        "compareRunSections": [section],
        "isAccordionReordered": True,
        "runListHidden": True,
        "runsHiddenMode": "SHOWALL",
        "hideEmptyCharts": True,
        "autoRefreshEnabled": True,
    }


def _scatter(title: str, x: str, y: str) -> _Chart:
    axes = {"xaxis": {"key": x, "type": "PARAM"}, "yaxis": {"key": y, "type": "METRIC"}}
    return {**_chart("SCATTER", title), **axes}


def _chart(kind: str, title: str) -> _Chart:
    named = {"uuid": sha256(title.encode()).hexdigest()[:16], "type": kind, "displayName": title}
    return {**named, "runsCountToCompare": _MOST_RUNS, "deleted": False, "isGenerated": False}


def _metric(name: str) -> str:
    return f"metrics.`{name}`"


def _param(name: str) -> str:
    return f"params.`{name}`"
