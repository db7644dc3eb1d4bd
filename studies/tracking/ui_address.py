"""Which page of a running MLflow server shows a project's answer: asked from the server, without MLflow."""

import base64
import json
import urllib.request
from collections.abc import Mapping
from typing import Any

from studies.tracking.mlflow_view import LEADERBOARD, SHARED_VIEW, view_address

ALL = "#/experiments?workflowType=machine_learning"


def leaderboard_page(server: str, *, label: str | None, password: str = "") -> str:
    """Return the end of the address of a label's leaderboard.

    Args:
        server: the server's address, ending in a slash.
        label: whose; None for the one that was worked on last.
        password: the administrator's, where the server asks for one.

    Returns:
        The leaderboard's, or that of all experiments where there is no such one.
    """
    try:
        found = _experiments(server, password)
        chosen = _newest(server, found, password) if label is None else found.get(label)
    except (OSError, ValueError, KeyError):  # a page that cannot be found is no reason not to open the others
        return ALL
    if chosen is None:
        return ALL
    if any(tag["key"] == f"{SHARED_VIEW}{LEADERBOARD}" for tag in chosen.get("tags", [])):
        return view_address(chosen["experiment_id"], LEADERBOARD)
    return f"#/experiments/{chosen['experiment_id']}/runs?workflowType=machine_learning"


def _experiments(server: str, password: str) -> dict[str, dict[str, Any]]:
    found = _ask(server, "experiments/search", {"max_results": 1000}, password)
    return {one["name"]: one for one in found.get("experiments", [])}


def _newest(server: str, found: Mapping[str, dict[str, Any]], password: str) -> dict[str, Any] | None:
    ids = {one["experiment_id"]: one for one in found.values()}
    asked = {"experiment_ids": list(ids), "max_results": 1, "order_by": ["attributes.start_time DESC"]}
    runs = _ask(server, "runs/search", asked, password).get("runs", [])
    return ids[runs[0]["info"]["experiment_id"]] if runs else None


def _ask(server: str, what: str, content: Mapping[str, Any], password: str) -> dict[str, Any]:
    request = urllib.request.Request(
        f"{server}api/2.0/mlflow/{what}",
        data=json.dumps(content).encode(),
        headers={"Content-Type": "application/json"},
    )
    if password:
        token = base64.b64encode(f"admin:{password}".encode()).decode()
        request.add_header("Authorization", f"Basic {token}")
    with urllib.request.urlopen(request, timeout=20.0) as answer:
        found = json.loads(answer.read())
    return found if isinstance(found, dict) else {}
