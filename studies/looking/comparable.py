"""What studies, trials, labels or calibrations are compared by: settings, origins and results."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from studies.looking.card import METRICS, best_so_far
from studies.looking.project import Project, StageLook, StudyLook
from studies.looking.things import LabelThing, Thing, TrialThing
from studies.paths import size_name
from studies.report.wording import squared
from studies.tuning.trial_record import best_record

JUDGED_BY = ("case", "validation", "test")
"""Digests without which errors of models cannot be compared."""
SCREENED = {"mse_surrogate": "MSE surrogate", "mse_screened": "MSE screened", "screening_gap": "gap"}
"""What screening came to, as the tables of `studies calibrate` call it."""
CODE = ("git_commit", "git_dirty", "python", "numpy", "scipy", "torch", "fmpy", "cpu", "device")
"""What of an environment a person would name first."""


@dataclass(frozen=True)
class Comparable:
    """One side of a comparison.

    Args:
        name: what it is called.
        unit: unit of its errors.
        judged_by: what must be the same on all sides for errors to be comparable, digests by name.
        settings: what it was made from, as JSON values by name.
        results: what it came to, by name.
    """

    name: str
    unit: str
    judged_by: Mapping[str, str]
    settings: Mapping[str, Any]
    results: Mapping[str, float]


def comparables(project: Project, things: Sequence[Thing]) -> list[Comparable]:
    """Return the sides of a comparison; all things are of one kind."""
    studies = [thing for thing in things if isinstance(thing, StudyLook)]
    labels = [thing for thing in things if isinstance(thing, LabelThing)]
    counts = equal_counts([len(study.records) for study in studies])
    n_equal = _equal_trials(labels)
    found = []
    for thing in things:
        if isinstance(thing, TrialThing):
            found.append(_of_trial(thing))
        elif isinstance(thing, StudyLook):
            found.append(_of_study(thing, counts))
        elif isinstance(thing, LabelThing):
            found.append(_of_label(thing, n_equal))
        elif isinstance(thing, StageLook):
            found.append(_of_calibration(project, thing))
    return found


def equal_counts(n_trials: Sequence[int]) -> list[int]:
    """Return the numbers of trials at which studies are compared: powers of two, and what all have."""
    most = min(n_trials, default=0)
    return sorted({2**k for k in range(20) if 2**k <= most} | ({most} if most else set()))


def _of_trial(thing: TrialThing) -> Comparable:
    record = thing.record
    names = [name for name in dict.fromkeys([*METRICS, *record.metrics]) if name in record.metrics]
    return Comparable(
        name=thing.name,
        unit=thing.study.unit,
        judged_by=_judges(record.digests),
        settings={
            "state": f"{record.state}: {record.reason}".removesuffix(": "),
            "n_train": record.n_train,
            **record.config,
            "seed": record.seed,
            **_data(record.digests),
            **_code(record.environment),
        },
        results={
            **{name: record.metrics[name] for name in names},
            "epochs": record.n_epochs,
            "training [s]": record.wall_s,
        },
    )


def _of_study(study: StudyLook, counts: Sequence[int]) -> Comparable:
    best, course = study.best, best_so_far(study.records)
    entry = study.entry
    return Comparable(
        name=study.called,
        unit=study.unit,
        judged_by=_judges(entry.digests),
        settings={
            "n_train": study.n_train,
            "seed": entry.seed,
            "trials planned": study.n_planned,
            **_flat(_profile(study).get("tuning", {"variant": entry.variant})),
            **_data(entry.digests),
            **(_code(best.environment) if best else {}),
            **({f"best: {name}": value for name, value in best.config.items()} if best else {}),
        },
        results={
            **({name: best.metrics[name] for name in METRICS if name in best.metrics} if best else {}),
            **{f"val/mae, best of first {n}": float(course[n - 1]) for n in counts},
            "trials": len(study.records),
            "pruned": study.count("pruned"),
            "failed": study.count("failed"),
            "training [s]": sum(record.wall_s for record in study.records),
        },
    )


def _of_label(thing: LabelThing, n_equal: Mapping[int, int]) -> Comparable:
    """Compare a label by its sizes, each at as many trials as all labels have of it."""
    results: dict[str, float] = {}
    latest = {study.n_train: study for study in sorted(thing.studies, key=lambda one: one.began_s)}
    for n_train, n_trials in sorted(n_equal.items()):
        best = best_record(latest[n_train].records[:n_trials])
        if best is not None:
            said = f"{size_name(n_train)}, best of first {n_trials}:"
            results |= {f"{said} {name}": best.metrics[name] for name in ("val/mae", "test/mae")}
    for stage in thing.stages:
        if stage.is_calibration and math.isfinite(stage.mse):
            results |= {f"{stage.stage}: MSE": stage.mse, f"{stage.stage}: calls": stage.n_calls}
    study = next(iter(latest.values()), None)
    settings: dict[str, Any] = {"sizes": ", ".join(map(str, sorted(latest)))}
    if study is not None:
        settings |= _flat({"variant": study.entry.variant, "seed": study.entry.seed} | _profile(study))
        settings |= _data({name: d for name, d in study.entry.digests.items() if name != "train"})
    judges = _judges(study.entry.digests) if study else {}
    return Comparable(thing.name, study.unit if study else "", judges, settings, results)


def _of_calibration(project: Project, stage: StageLook) -> Comparable:
    found, ledger = stage.summary, stage.summary["ledger"]
    results = {said: found[name] for name, said in SCREENED.items() if found.get(name) is not None}
    if math.isfinite(stage.mse):
        results["final MSE"] = stage.mse
    told_below = ("is_log", "restriction")
    inputs = {name: value for name, value in stage.manifest["inputs"].items() if name not in told_below}
    return Comparable(
        name=stage.name,
        unit=squared(project.unit_of(stage.label)),
        judged_by={name: str(found.get(f"{name}_sha256", "")) for name in ("case", "measurement")},
        settings={
            "method": found.get("method", "screen, then polish"),
            "n_train": found["n_train"],
            **_flat(inputs),
            "calibrated parameters": len(found["theta"]) - len(stage.fixed),
            **{f"fixed: {name}": one.value for name, one in stage.fixed.items()},
            **_code(stage.manifest.get("environment") or stage.manifest.get("versions") or {}),
        },
        results={
            **results,
            "calls (paper)": ledger["total_paper"],
            "calls (all)": ledger["total_honest"],
            **({"stored before": stage.n_known} if stage.n_known else {}),
            "took [s]": float(stage.manifest.get("wall_s", 0.0)),
            **{f"theta {name}": value for name, value in found["theta"].items() if name not in stage.fixed},
        },
    )


def _equal_trials(labels: Sequence[LabelThing]) -> dict[int, int]:
    """Return the trials that every label has of each size that all of them have."""
    tried = [
        {study.n_train: len(study.records) for study in sorted(label.studies, key=lambda one: one.began_s)}
        for label in labels
    ]
    common = set(tried[0]).intersection(*tried[1:]) if tried else set()
    return {n_train: min(one[n_train] for one in tried) for n_train in common}


def _profile(study: StudyLook) -> dict[str, Any]:
    profile: dict[str, Any] = study.entry.recipe.get("profile", {})
    return {name: value for name, value in profile.items() if name not in ("name", "note", "schema")}


def _judges(digests: Mapping[str, str]) -> dict[str, str]:
    return {name: digests.get(name, "") for name in JUDGED_BY}


def _data(digests: Mapping[str, str]) -> dict[str, str]:
    return {f"{name} digest": digest for name, digest in digests.items()}


def _code(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: environment[name] for name in CODE if name in environment}


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested settings with dots in their names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= {f"{name}.{key}": one for key, one in _flat(value).items()}
        else:
            flat[name] = value
    return flat
