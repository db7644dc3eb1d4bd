"""What a command would do, how long that takes and how much room it needs; nothing is written."""

import json
import shutil
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from studies.console import Block, Column, Facts, Said, Table, format_seconds
from studies.looking.project import Project, StageLook, look_at
from studies.looking.stored_rows import StoredRows, designs, stored_rows
from studies.looking.trial_cost import TrialCost, trial_costs
from studies.paths import size_name
from studies.profile import Profile
from studies.report.wording import MISSING, count
from studies.stages.pipeline import Study

ENOUGH = 200
"""Simulations from which a campaign's wall time tells what one costs: starting the workers takes seconds."""
TRIAL_BYTES = 1e5
"""Room of a trial with its curves in Optuna's and MLflow's stores; measured on the office. [byte]"""
REPORT_BYTES = 5e6


@dataclass(frozen=True)
class Step:
    """A part of what would be done.

    Args:
        what: its name.
        to_do: what is left of it.
        planned: all of it.
        unit: what is counted.
        seconds: wall time of what is left, None where nothing tells. [s]
        basis: where that is known from.
        n_bytes: room of what is left on the disk. [byte]
    """

    what: str
    to_do: int
    planned: int
    unit: str
    seconds: float | None
    basis: str
    n_bytes: float = 0.0


@dataclass(frozen=True)
class Forecast:
    """All that would be done.

    Args:
        label: label of the study.
        n_jobs: processes.
        steps: the parts, in order.
        seconds: wall time of those whose time is known. [s]
        free_bytes: room on the disk. [byte]
    """

    label: str
    n_jobs: int
    steps: tuple[Step, ...]
    seconds: float
    free_bytes: float


def forecast(study: Study, *, whole: bool) -> Forecast:
    """Say what a command would do.

    Args:
        study: the study.
        whole: all stages (`studies run`), or simulations and tuning alone (`studies tune`).
    """
    project, rows = look_at(study.paths), stored_rows(study.paths, study.case)
    simulating = _simulations(project, study, rows, with_sensitivity=whole)
    tuning = _trials(project, study)
    steps = [*simulating, *tuning]
    if whole:
        steps = [_check(project, study), *steps, *_calibrations(project, study, tuning)]
        steps.append(_report(project, study, is_finished=not any(step.to_do for step in steps)))
    root = next(place for place in (study.paths.mlruns, study.paths.root) if place.is_dir())
    alone = sum(step.seconds or 0.0 for step in steps if step.to_do and step not in tuning)
    seconds = alone + _side_by_side(tuning, study.n_jobs, study.profile.tuning.n_parallel)
    return Forecast(study.label, study.n_jobs, tuple(steps), seconds, float(shutil.disk_usage(root).free))


def forecast_blocks(found: Forecast) -> list[Block]:
    """Return what a person sees."""
    columns = [
        Column("step"),
        Column("to do", True),
        Column("of", True),
        Column("", spare=2),
        Column("time", True),
        Column("known from", spare=1),
    ]
    rows = []
    for step in found.steps:
        time_said = MISSING if step.seconds is None else format_seconds(step.seconds)
        tone = "" if step.to_do else "dim"
        cells = [step.what, step.to_do, step.planned, step.unit]
        rows.append(
            [
                *(Said(str(cell), tone) for cell in cells),  # type: ignore[arg-type]
                Said(time_said if step.to_do else "done", tone),  # type: ignore[arg-type]
                Said(step.basis if step.to_do else "", "dim"),
            ]
        )
    unknown = sum(step.to_do > 0 and step.seconds is None for step in found.steps)
    n_bytes = sum(step.n_bytes for step in found.steps)
    is_idle = not any(step.to_do for step in found.steps)
    time_said = f"about {format_seconds(found.seconds)} with {count(found.n_jobs, 'process', 'processes')}"
    more = f", without {count(unknown, 'step')} of unknown time" if unknown else ""
    room = f"about {_room(n_bytes)} of the {_room(found.free_bytes)} that are free"
    facts = [
        ("time", "nothing is left to do" if is_idle else f"{time_said}{more}"),
        ("disk", Said(room, "bad" if n_bytes > 0.9 * found.free_bytes else "")),
    ]
    title = f"{found.label}: what would be done (nothing is written)"
    return [Table(title, columns, rows, is_dense=True), Facts("", facts)]


def forecast_document(command: str, found: Forecast) -> dict[str, Any]:
    """Return what a program reads."""
    return {
        "command": command,
        "dry_run": True,
        "label": found.label,
        "n_jobs": found.n_jobs,
        "steps": [asdict(step) for step in found.steps],
        "seconds": found.seconds,
        "is_time_known": all(step.seconds is not None for step in found.steps if step.to_do),
        "bytes": sum(step.n_bytes for step in found.steps),
        "bytes_free": found.free_bytes,
    }


def _simulations(project: Project, study: Study, rows: StoredRows, *, with_sensitivity: bool) -> list[Step]:
    each_s, basis = _simulation_s(project, study)
    done = _finished(project, study, "sensitivity")
    expected = {"n_base": study.profile.sensitivity.n_base, "seed": study.profile.seed}
    is_analysed = done is not None and all(done.manifest["inputs"].get(k) == v for k, v in expected.items())
    steps = []
    for what, theta in designs(study.case, study.profile, with_sensitivity=with_sensitivity).items():
        to_do = 0 if what == "sensitivity" and is_analysed else len(theta) - rows.count(theta)
        seconds = None if each_s is None else to_do * each_s
        room = to_do * rows.bytes_per_row
        steps.append(Step(f"simulate: {what}", to_do, len(theta), "simulations", seconds, basis, room))
    return steps


def _simulation_s(project: Project, study: Study) -> tuple[float | None, str]:
    """Return the wall time of one simulation among many, and where that is known from."""
    alike = [one for one in project.stages if one.manifest["inputs"].get("case") == study.case.digest]
    campaigns = {
        one.summary["n_simulations"] - one.summary.get("n_reused", 0): one
        for one in alike
        if one.stage == "simulate"
    }
    checks = [one for one in alike if one.stage == "check"]
    most = max(campaigns, default=0)
    if most >= ENOUGH or (most and not checks):
        known = f"{count(most, 'simulation')} of {campaigns[most].label}"
        return float(campaigns[most].manifest["wall_s"]) / most, known
    if checks:
        return float(checks[0].summary["simulation_s"]) / study.n_jobs, f"examination of {checks[0].label}"
    return None, f"unknown: type studies check {study.command}"


def _trials(project: Project, study: Study) -> list[Step]:
    budget, profile = study.profile.tuning, study.profile
    finished = {n_train: _n_finished(project, study, n_train) for n_train in profile.data.n_train}
    planned = budget.n_different_trials
    left = {n_train: max(planned - n_done, 0) for n_train, n_done in finished.items()}
    if not any(left.values()):
        costs = {n_train: TrialCost(0.0, "") for n_train in left}
    else:
        costs = trial_costs(project, study, say=study.console.say)
    return [_trial_step(n_train, left[n_train], planned, costs[n_train]) for n_train in sorted(left)]


def _trial_step(n_train: int, left: int, planned: int, cost: TrialCost) -> Step:
    seconds = None if cost.seconds is None else left * cost.seconds
    each = f"{format_seconds(cost.seconds)} each: " if left and cost.seconds is not None else ""
    what = f"tune: {size_name(n_train)}"
    return Step(what, left, planned, "trials", seconds, f"{each}{cost.basis}", left * TRIAL_BYTES)


def _n_finished(project: Project, study: Study, n_train: int) -> int:
    """Return the trials of exactly this study that are finished.

    Settings, data and seed are compared by what the study's recipe says; building the study would read
    all its simulations.
    """
    wanted = _decisive(study.profile)
    counts = [
        len(look.records)
        for look in project.studies
        if (look.label, look.n_train) == (study.label, n_train)
        and look.entry.digests.get("case") == study.case.digest
        and look.entry.recipe
        and _decisive_values(look.entry.recipe.get("profile", {})) == wanted
    ]
    return max(counts, default=0)


def _decisive(profile: Profile) -> Any:
    return _decisive_values(json.loads(json.dumps(profile.to_dict())))


def _decisive_values(profile: Mapping[str, Any]) -> Any:
    """Return what of a profile decides the trials of a size."""
    tuning = {k: v for k, v in profile.get("tuning", {}).items() if k not in ("n_trials", "device")}
    data = {k: v for k, v in profile.get("data", {}).items() if k != "n_train"}
    return json.loads(json.dumps([tuning, data, profile.get("seed")], sort_keys=True))


def _check(project: Project, study: Study) -> Step:
    done = _finished(project, study, "check")
    is_done = done is not None and done.manifest["inputs"].get("profile") == json.loads(
        json.dumps(study.profile.to_dict())
    )
    seconds, basis = _earlier(project, study, "check")
    return Step("check", int(not is_done), 1, "examination", seconds, basis)


def _calibrations(project: Project, study: Study, tuning: Sequence[Step]) -> list[Step]:
    steps = []
    for n_train, tuned in zip(sorted(study.profile.data.n_train), tuning, strict=True):
        stage = f"calibrate-{size_name(n_train)}"
        done = _finished(project, study, stage)
        is_done = (
            done is not None
            and not tuned.to_do
            and done.manifest["inputs"].get("measurement") == study.case.measurement.digest
            and done.manifest["inputs"].get("polish") == asdict(study.profile.polish)
        )
        seconds, basis = _earlier(project, study, "calibrate-n")
        steps.append(
            Step(f"calibrate: {size_name(n_train)}", int(not is_done), 1, "calibration", seconds, basis)
        )
    return steps


def _report(project: Project, study: Study, *, is_finished: bool) -> Step:
    is_done = is_finished and _finished(project, study, "report") is not None
    seconds, basis = _earlier(project, study, "report")
    return Step("report", int(not is_done), 1, "page", seconds, basis, 0.0 if is_done else REPORT_BYTES)


def _finished(project: Project, study: Study, stage: str) -> StageLook | None:
    """Return a finished stage of this label and physics."""
    for one in project.stages:
        is_ours = (one.label, one.stage) == (study.label, stage)
        if is_ours and one.manifest["inputs"].get("case") == study.case.digest:
            return one
    return None


def _earlier(project: Project, study: Study, beginning: str) -> tuple[float | None, str]:
    """Return how long stages of a kind took before for the same physics."""
    found = [
        one
        for one in project.stages
        if one.stage.startswith(beginning) and one.manifest["inputs"].get("case") == study.case.digest
    ]
    if not found:
        return None, "unknown: none yet"
    labels = ", ".join(sorted({one.label for one in found}))
    return statistics.mean(float(one.manifest["wall_s"]) for one in found), f"{len(found)} of {labels}"


def _side_by_side(tuning: Sequence[Step], n_jobs: int, n_parallel: int) -> float:
    """Return the wall time of studies that share processes: none goes faster than its own trials allow."""
    seconds = [step.seconds or 0.0 for step in tuning]
    lanes = min(n_jobs, n_parallel)
    return max([sum(seconds) / n_jobs, *(one / lanes for one in seconds)])


def _room(n_bytes: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if n_bytes >= size:
            return f"{n_bytes / size:.3g} {unit}"
    return f"{n_bytes / 1e3:.0f} kB"
