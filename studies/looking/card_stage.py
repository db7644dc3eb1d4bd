"""What `studies show` tells of a calibration, another stage, a row set or a digest."""

import math
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simulation.store.row_set import RowSet
from studies.console import Block, Column, Facts, Said, Table, Tone, format_seconds
from studies.looking.card import environment_facts, mlflow_text
from studies.looking.changed import changed_since
from studies.looking.curve import plot
from studies.looking.mlflow_runs import find_runs
from studies.looking.project import Project, StageLook
from studies.looking.things import DigestThing, RowSetThing
from studies.report.wording import bound_at, count, quantity, shown_unit, squared
from studies.stages.pipeline import read_json


def stage_blocks(project: Project, stage: StageLook) -> list[Block]:
    """Return what is known of a finished stage."""
    blocks = _calibration(project, stage) if stage.is_calibration else _summary(stage)
    made = stage.manifest
    finished = str(made.get("finished", ""))[:16].replace("T", " ")
    environment = made.get("environment") or made.get("versions") or {}
    facts: list[tuple[str, object]] = [
        ("finished", f"{finished} UTC on {made.get('host', '?')}"),
        ("took", format_seconds(float(made.get("wall_s", 0.0)))),
        ("seed", made.get("seed", "")),
        *environment_facts(environment),
        ("digest", str(made.get("digest", ""))[:16]),
        ("files", ", ".join([project.paths.show(stage.file), *list(made.get("files", {}))[:4]])),
        ("MLflow", mlflow_text(find_runs(project.paths, tag=("stage_key", str(made.get("digest")))))),
    ]
    return [*blocks, Facts("", facts)]


def stage_values(stage: StageLook) -> dict[str, Any]:
    """Return what a program reads of a stage."""
    values = {**stage.manifest, "label": stage.label, "is_calibration": stage.is_calibration}
    return values | {"fixed": fixed_values(stage)} if stage.is_calibration else values


def fixed_values(stage: StageLook) -> dict[str, Any]:
    """Return what a program reads of the parameters that a calibration held fixed."""
    return {name: asdict(one) for name, one in stage.fixed.items()}


def fixed_tables(stage: StageLook) -> list[Block]:
    """Return a table of the parameters that a calibration held fixed, none where it calibrated all."""
    columns = [Column("parameter"), Column("unit"), Column("fixed at", True), Column("which is")]
    rows = [[name, shown_unit(one.unit), f"{one.value:.6g}", one.why] for name, one in stage.fixed.items()]
    return [Table("fixed as least relevant", columns, rows, is_dense=True)] if rows else []


def row_set_blocks(project: Project, thing: RowSetThing) -> list[Block]:
    """Return what is known of a row set."""
    rows = RowSet.load(thing.file)
    facts: list[tuple[str, object]] = [
        ("rows", f"{count(rows.n)}, {count(rows.theta.shape[1], 'parameter')} each"),
        ("digest", thing.digest),
        ("file", project.paths.show(thing.file)),
        ("simulations", project.paths.show(Path(os.path.normpath(rows.store)))),
        ("used by", ", ".join(thing.users)),
    ]
    return [Facts(f"{thing.name}: a set of stored simulations", facts)]


def digest_blocks(thing: DigestThing) -> list[Block]:
    """Return what has a digest."""
    return [
        Facts(f"{thing.name[:16]}: {thing.what}", [("sha256", thing.name), ("of", "\n".join(thing.users))])
    ]


def _calibration(project: Project, stage: StageLook) -> list[Block]:
    found, unit = stage.summary, squared(project.unit_of(stage.label))
    calls = count(found["ledger"]["total_honest"])
    if stage.has_paper_count:
        calls = f"{count(stage.n_calls)} in the paper's count, {calls} in all"
    if stage.n_known:
        calls += f", begun with {count(stage.n_known, 'stored simulation')}"
    surrogate = found.get("surrogate") or {}
    origin = f"{surrogate['study']}/t{surrogate['trial']:03d}" if surrogate else "none: the adaptive method"
    gap = found.get("screening_gap")
    target = [str(found.get(name))[:8] for name in ("case_sha256", "measurement_sha256")]
    facts: list[tuple[str, object]] = [
        ("final MSE", Said(_mse(stage.mse, unit), "strong")),
        ("screened", "" if "mse_screened" not in found else _screened(found, gap, unit)),
        ("calls", calls),
        ("ended because", found.get("polish_stop_reason", found.get("stop_reason", ""))),
        ("surrogate", origin),
        ("digests", f"case {target[0]}, measurement {target[1]}"),
        ("changed since", Said(", ".join(changed_since(project, stage)), "warn")),
        ("note", found.get("note", "")),
    ]
    drawn = _convergence(project, stage, unit)
    parameters = _parameters(project, stage)
    return [
        Facts(f"{stage.name}: calibration", facts),
        parameters,
        *fixed_tables(stage),
        *([Said(drawn), Said("")] if drawn else []),
    ]


def _screened(found: Mapping[str, Any], gap: float | None, unit: str) -> str:
    screened = found["mse_screened"]
    if screened is None:
        return "the physical model could not simulate the screened point"
    by = "" if gap is None else f", {quantity(gap, unit)} above what the surrogate promised"
    return f"{quantity(screened, unit, 4)}{by}"


def _mse(value: float, unit: str) -> str:
    return quantity(value, unit, 4) if math.isfinite(value) else "failed"


def _convergence(project: Project, stage: StageLook, unit: str) -> str:
    file = stage.result_file.with_suffix(".npz")
    try:
        with np.load(file, allow_pickle=False) as arrays:
            calls, mse = arrays["history_calls"], arrays["history_mse"]
    except (OSError, ValueError, KeyError, EOFError):
        return ""
    # Best values stand until a better one is found: drawn as the steps that they are.
    finite = np.isfinite(mse)
    calls, mse = np.repeat(calls[finite], 2)[1:].astype(float), np.repeat(mse[finite], 2)[:-1]
    name = f"least MSE [{unit}]" if unit else "least MSE"
    return plot(calls, mse, x_name="model calls", y_name=name)


def _parameters(project: Project, stage: StageLook) -> Table:
    box = _box(project, stage.label)
    theta, screened = stage.summary["theta"], stage.summary.get("theta_screened") or {}
    columns = [Column("parameter"), Column("unit"), Column("calibrated", True)]
    columns += [Column("screened", True, 2)] if screened else []
    columns += [Column("bounds", True, 1), Column("", spare=3)] if box else []
    rows = []
    for name, value in theta.items():
        if name in stage.fixed:
            continue
        row = [name, shown_unit(stage.units.get(name, "")), f"{value:.6g}"]
        row += [f"{screened[name]:.4g}"] if screened else []
        if name in box:
            lower, upper, scale = box[name]
            row += [f"{lower:.4g} to {upper:.4g}", _at_bound(value, lower, upper, scale)]
        rows.append(row)
    return Table("", columns, rows, is_dense=True)


def _at_bound(value: float, lower: float, upper: float, scale: str) -> str:
    if scale == "log":
        value, lower, upper = math.log(value), math.log(lower), math.log(upper)
    bound = bound_at((value - lower) / (upper - lower))
    return f"at the {bound} bound" if bound else ""


def _box(project: Project, label: str) -> dict[str, tuple[float, float, str]]:
    """Return bounds and scales of the parameters, which a champion of the label knows."""
    for folder in sorted(project.paths.champions(label).glob("n*/champion.json")):
        known = read_json(folder) or {}
        names = known.get("parameter_names", [])
        box = zip(known["lower"], known["upper"], known["scales"], strict=True)
        return dict(zip(names, box, strict=True))
    return {}


def _summary(stage: StageLook) -> list[Block]:
    """Return the results of a stage that is no calibration, as far as they are numbers and words."""
    facts: list[tuple[str, object]] = []
    for name, value in stage.summary.items():
        if isinstance(value, str | int | float):
            facts.append((name.replace("_", " "), _short(value)))
        elif isinstance(value, dict):
            plain = {key: one for key, one in value.items() if isinstance(one, str | int | float)}
            facts.append(
                (name.replace("_", " "), ", ".join(f"{key} {_short(v)}" for key, v in plain.items()))
            )
    blocks: list[Block] = [Facts(f"{stage.name}: finished stage", facts)]
    if stage.stage == "check":
        columns = [Column("examination"), Column(""), Column("found")]
        tones: dict[str, Tone] = {"ok": "good", "warn": "warn", "fail": "bad"}
        rows = [
            [one["what"], Said(one["level"], tones.get(one["level"], "")), one["found"]]
            for one in stage.summary["findings"]
        ]
        blocks += [Table("", columns, rows, is_dense=True)]
    return blocks


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return str(value)[:12] if isinstance(value, str) and len(str(value)) == 64 else str(value)
