"""Where simulations begin and where the first samples lie, wherever these are not the same moment."""

from collections.abc import Iterator

import numpy as np

from simulation.case import Case
from simulation.case_data import GAP_STEPS
from simulation.time_unit import DAY_S, unit_for
from studies.doctor.finding import LONGEST, Finding, finding
from studies.words.console import Console

_SAME = 1e-6
"""Moments that are no farther apart than this share of an output step are the same, as in the comparison."""


def look_at_begin(case: Case) -> Iterator[Finding]:
    """Say where a single experiment's simulation begins, if it is not where its first sample lies.

    It is worth a look where no warm-up was asked for and more than usual steps lie between. What the FMU
    counts its own time in is said if it is not seconds.
    """
    if (unit_s := case.settings.time_unit_s) != 1.0:
        yield finding("own-time", "ok", unit_s=unit_s)
    if said := _said(case):
        usual_s = max(float(np.median(np.diff(one.samples.time))) for one in case.outputs if one.is_measured)
        is_late = not case.scenario.n_warmup and _later_s(case) > GAP_STEPS * usual_s
        yield finding("begin", "warn" if is_late else "ok", said=said)


def say_begin(case: Case, console: Console) -> None:
    """Say the same before a calibration, of each experiment."""
    lines = [f"experiment {one.name}: {said}" for one, its in case.members if (said := _said(its))]
    if not case.members and (said := _said(case)):
        lines = [said]
    for line in lines[:LONGEST]:
        console.say(line)
    if len(lines) > LONGEST:
        console.say(f"{len(lines) - LONGEST} more experiments begin before their first samples")


def _said(case: Case) -> str:
    """Return the sentence, "" where the first sample lies at the begin."""
    later_s, start_s = _later_s(case), float(case.scenario.time_communication[0])
    if later_s <= _SAME * case.output_step_s:
        return ""
    unit = unit_for(later_s)
    later = f"{unit.of_days(later_s / DAY_S):.4g} {unit.symbol}"
    return (
        f"the simulation begins at {start_s:.12g} s, the first sample lies at {start_s + later_s:.12g} s, "
        f"{later} later"
    )


def _later_s(case: Case) -> float:
    """Return how long after the begin of the simulation the first compared sample lies. [s]."""
    first_s = min(one.samples.begin_s for one in case.outputs if one.is_measured)
    return first_s - float(case.scenario.time_communication[0])
