"""Whether somebody still works on what MLflow shows as running."""

import json
import time
from collections.abc import Collection

from studies.keeping.mlflow_tables import RunRow
from studies.tracking.mlflow_runs import GRACE_S
from studies.tuning.claim import is_dead, this_machine


def is_worked_on(run: RunRow, busy: Collection[str]) -> bool:
    """Return whether the process that a run belongs to lives, or somebody trains a trial of its study.

    Args:
        run: a run that says it is running.
        busy: names of the studies that somebody works on.
    """
    if run.role == "study" and run.tags.get("study_key") in busy:
        return True
    try:
        owner = json.loads(run.tags.get("owner", ""))
        silence_s = time.time() - float(owner["heard_s"])
        return not is_dead(owner, 0.0) if owner["machine"] == this_machine() else silence_s < GRACE_S
    except (ValueError, KeyError, TypeError):
        return time.time() - run.started_ms / 1000.0 < GRACE_S
