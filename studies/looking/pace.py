"""How fast a study goes, when it will be finished, and whether anybody works on it."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from studies.looking.project import StudyLook
from studies.tuning.trial_record import TrialRecord

N_RECENT = 12
"""Trials that tell the pace of today."""
PAUSE = 3.0
"""A silence of more typical trials than this was a pause, not a slow trial."""
LEAST_PAUSE_S = 30.0
"""Starting a command anew takes seconds; nobody would call that a pause. [s]"""

Mood = Literal["finished", "running", "waiting", "stopped"]


@dataclass(frozen=True)
class Pace:
    """How a study gets on.

    Args:
        mood: finished; running; waiting, where another study of its label runs; stopped.
        trials_per_h: pace of the latest trials without pauses, None where nothing tells. [1/h]
        to_go_s: time until the planned trials are finished, None where nobody works on it. [s]
        host: machines that work on it, or that did so last.
        heard_s: when it last gave a sign of life, 0 where never. [s since 1970, UTC]
    """

    mood: Mood
    trials_per_h: float | None
    to_go_s: float | None
    host: str
    heard_s: float


def pace_of(study: StudyLook, *, is_label_running: bool) -> Pace:
    """Tell how a study gets on.

    Args:
        study: the study.
        is_label_running: whether any study of its label has a running trial.
    """
    rate = trials_per_s(study.records)
    left = study.n_planned - len(study.records)
    mood: Mood = "finished" if left <= 0 else "waiting" if is_label_running else "stopped"
    if study.running:
        mood = "running"
    begun = sum(trial.epoch / trial.max_epochs for trial in study.running if trial.max_epochs)
    to_go_s = max(left - begun, 0.0) / rate if mood == "running" and rate else None
    last = max(study.records, key=lambda record: record.ended_s, default=None)
    heard = [trial.heard_s for trial in study.running] + ([last.ended_s] if last else [])
    owners = [trial.owner for trial in study.running] or ([last.owner] if last else [])
    return Pace(
        mood=mood,
        trials_per_h=rate * 3600.0 if rate else None,
        to_go_s=to_go_s,
        host=", ".join(sorted({str(owner.get("host", "?")) for owner in owners})),
        heard_s=max(heard, default=0.0),
    )


def trials_per_s(records: Sequence[TrialRecord]) -> float | None:
    """Return the pace of the latest trials, from the begin of the first to the end of the last. [1/s].

    Where somebody paused (stopped the command and went on the next day), only what came after counts.
    """
    recent = sorted(records, key=lambda record: record.ended_s)[-N_RECENT:]
    if not recent:
        return None
    pause_s = max(PAUSE * statistics.median(record.wall_s for record in recent), LEAST_PAUSE_S)
    n, began_s = 0, recent[-1].ended_s
    for record in reversed(recent):
        if n and began_s - record.ended_s > pause_s:
            break
        n, began_s = n + 1, min(began_s, record.started_s)
    span_s = recent[-1].ended_s - began_s
    return n / span_s if span_s > 0.0 else None
