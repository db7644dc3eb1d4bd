"""What `studies show` tells of a trial, a study or a label."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from studies.console import Block, Column, Facts, Said, Table, format_seconds
from studies.looking.curve import plot, sparkline
from studies.looking.mlflow_runs import RunAddress, find_runs
from studies.looking.pace import pace_of
from studies.looking.project import Project, StudyLook
from studies.looking.status import calibrations_table, studies_table, study_lines
from studies.looking.things import LabelThing, TrialThing
from studies.looking.wording import ago, error, moment
from studies.report.wording import count, setting
from studies.tuning.trial_record import TrialRecord, trial_name

METRICS = ("val/mae", "val/p90", "test/mae", "test/p90")
REASONS = {"max_epochs": "limit of epochs reached", "patience": "no better any more"}
"""Why a training ended, for a person."""
N_TRIALS = 40
"""Trials of a study that are listed at most; the best ones."""


def trial_blocks(project: Project, thing: TrialThing) -> list[Block]:
    """Return what is known of a trial."""
    study, record = thing.study, thing.record
    best, default = study.best, study.default
    rank = _rank(study, record)
    searched = [name.removeprefix("log2_") for name in record.params]
    facts: list[tuple[str, object]] = [
        ("state", _state(record)),
        ("rank", rank),
        ("hyperparameters", _settings({name: record.config.get(name) for name in searched})),
        ("chosen by", record.origin),
        ("other settings", _settings({k: v for k, v in record.config.items() if k not in searched})),
        ("trained on", f"{count(record.n_rows)} of {count(record.n_train, 'row')}"),
        ("seed", record.seed),
        ("begun", f"{moment(record.started_s)}, {ago(record.started_s)}"),
        ("took", format_seconds(record.wall_s)),
        ("by", _owner(record.owner) + (f", attempt {record.attempts}" if record.attempts > 1 else "")),
    ]
    blocks: list[Block] = [Facts(f"{thing.name}: trial {record.index} of study {study.name}", facts)]
    columns = [Column("errors" + (f" [{study.unit}]" if study.unit else "")), Column("this", True)]
    others = [("best", best), ("default", default)]
    columns += [Column(f"{name} ({trial_name(other.index)})", True) for name, other in others if other]
    names = list(dict.fromkeys([*METRICS, *record.metrics]))
    rows = [
        [name, *(error(one.metrics.get(name)) for one in (record, best, default) if one is not None)]
        for name in names
        if name in record.metrics
    ]
    if rows:
        blocks += [Table("", columns, rows, is_dense=True)]
    blocks += _learning_curve(study, record)
    blocks.append(
        Facts(
            "",
            [
                *environment_facts(record.environment),
                ("digests", digests_text(record.digests)),
                ("files", _place(project, study, record)),
                ("MLflow", mlflow_text(find_runs(project.paths, tag=("trial_key", record.key)))),
            ],
        )
    )
    return blocks


def trial_values(thing: TrialThing) -> dict[str, Any]:
    """Return what a program reads of a trial."""
    record = thing.record
    return {
        "study": record.study,
        "n_train": record.n_train,
        "index": record.index,
        "state": record.state,
        "reason": record.reason,
        "origin": record.origin,
        "params": record.params,
        "config": record.config,
        "seed": record.seed,
        "metrics": record.metrics,
        "n_epochs": record.n_epochs,
        "best_epoch": record.best_epoch,
        "n_rows": record.n_rows,
        "started_s": record.started_s,
        "wall_s": record.wall_s,
        "owner": record.owner,
        "attempts": record.attempts,
        "environment": record.environment,
        "digests": record.digests,
        "place": thing.study.store.place,
    }


def study_blocks(project: Project, study: StudyLook) -> list[Block]:
    """Return what is known of a study."""
    entry, best = study.entry, study.best
    pace = pace_of(study, is_label_running=False)
    to_go = "" if pace.to_go_s is None else f", {format_seconds(pace.to_go_s)} to go"
    states = ", ".join(
        f"{study.count(state)} {state}" for state in ("complete", "pruned", "failed") if study.count(state)
    )
    facts: list[tuple[str, object]] = [
        ("state", f"{pace.mood}{to_go}; last sign {ago(pace.heard_s)}"),
        ("trials", f"{len(study.records)} of {study.n_planned}: {states}" if states else study.n_planned),
        ("best", f"{trial_name(best.index)}, MAE val {error(best.value)} {study.unit}" if best else ""),
        ("best so far", sparkline(best_so_far(study.records))),
        ("case", entry.case_name),
        ("variant", entry.variant),
        ("seed", entry.seed),
        ("side by side", f"{count(entry.n_parallel, 'trial')} at most" if entry.n_parallel > 1 else ""),
        ("asked for", f"{moment(entry.created_s)}, {ago(entry.created_s)}" if entry.created_s else ""),
        ("command", entry.recipe.get("command", "")),
        ("digests", digests_text(entry.digests)),
        ("files", _place(project, study)),
        ("MLflow", mlflow_text(find_runs(project.paths, tag=("study_key", study.name), role="study"))),
        ("note", entry.note),
    ]
    return [Facts(f"{study.short_name}: study {study.name}", facts), _trials(study)]


def study_values(study: StudyLook) -> dict[str, Any]:
    """Return what a program reads of a study."""
    best = study.best
    return {
        **{name: value for name, value in study.entry.to_dict().items() if name != "recipe"},
        "place": study.store.place,
        "best_trial": best.index if best else None,
        "trials": [
            {
                "index": record.index,
                "state": record.state,
                "reason": record.reason,
                "origin": record.origin,
                "params": record.params,
                "metrics": record.metrics,
                "wall_s": record.wall_s,
            }
            for record in study.records
        ],
    }


def label_blocks(project: Project, thing: LabelThing) -> list[Block]:
    """Return what is known of a label."""
    columns = [Column("stage"), Column("finished"), Column("took", True), Column("host"), Column("digest")]
    rows = [
        [
            stage.stage,
            str(stage.manifest.get("finished", ""))[:16].replace("T", " "),
            format_seconds(float(stage.manifest.get("wall_s", 0.0))),
            stage.manifest.get("host", ""),
            str(stage.manifest.get("digest", ""))[:8],
        ]
        for stage in sorted(thing.stages, key=lambda stage: str(stage.manifest.get("finished")))
    ]
    blocks: list[Block] = []
    if thing.studies:
        blocks.append(studies_table(study_lines(project, [thing.name])))
    calibrations = [stage for stage in thing.stages if stage.is_calibration]
    if calibrations:
        blocks.append(calibrations_table(project, calibrations))
    if rows:
        blocks.append(Table("", columns, rows, is_dense=True))
    index = project.paths.report(thing.name) / "index.html"
    if index.is_file():
        blocks.append(Facts("", [("report", project.paths.show(index))]))
    return blocks


def best_so_far(records: Sequence[TrialRecord]) -> Any:
    """Return the least validation error of the completed trials up to each one. Shape (trials,)."""
    import numpy as np

    values = [record.value if record.state == "complete" and record.value else np.inf for record in records]
    return np.minimum.accumulate(np.array(values, dtype=np.float64)) if values else np.zeros(0)


def environment_facts(environment: Mapping[str, str]) -> list[tuple[str, object]]:
    """Return what a result was made with: code, packages, machine."""
    if not environment:
        return []
    commit = environment.get("git_commit", "")[:10]
    changed = " with changes that are not committed" if environment.get("git_dirty") == "true" else ""
    packages = ("python", "numpy", "scipy", "torch", "optuna", "mlflow", "fmpy")
    threads = environment.get("n_threads", "")
    machine = [environment.get(name, "") for name in ("cpu", "platform", "device")]
    machine.append(f"{threads} BLAS threads" if threads else "")
    return [
        ("code", f"commit {commit}{changed}" if commit else ""),
        ("packages", ", ".join(f"{name} {environment[name]}" for name in packages if name in environment)),
        ("machine", "; ".join(filter(None, machine))),
    ]


def digests_text(digests: Mapping[str, str]) -> str:
    """Write digests as far as a person needs them to tell things apart."""
    return ", ".join(f"{name} {digest[:8]}" for name, digest in digests.items())


def mlflow_text(runs: Sequence[RunAddress]) -> str:
    """Write where a result stands in MLflow."""
    return "; ".join(f"run {run.run_id} at {run.page} of studies ui" for run in runs)


def _state(record: TrialRecord) -> Said:
    tones = {"complete": "good", "pruned": "warn", "failed": "bad"}
    reason = REASONS.get(record.reason, record.reason)
    how = f"{record.state}: {reason}" if reason else record.state
    epochs = f" after {count(record.n_epochs, 'epoch')}" if record.n_epochs else ""
    kept = f", weights of epoch {record.best_epoch} kept" if record.best_epoch else ""
    return Said(f"{how}{epochs}{kept}", tones[record.state])  # type: ignore[arg-type]


def _rank(study: StudyLook, record: TrialRecord) -> str:
    complete = [other for other in study.records if other.state == "complete"]
    complete.sort(key=lambda other: (other.metrics["val/mae"], other.index))
    if record not in complete:
        return ""
    return f"{complete.index(record) + 1} of {count(len(complete), 'completed trial')}"


def _settings(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {setting(value)}" for name, value in values.items())


def _owner(owner: Mapping[str, Any]) -> str:
    return f"{owner.get('host', '?')}, process {owner.get('pid', '?')}"


def _learning_curve(study: StudyLook, record: TrialRecord) -> list[Block]:
    try:
        history = study.store.history(record.index)
    except (KeyError, OSError, ValueError):
        return []
    if "validation_mae" not in history or "epoch" not in history:
        return []
    unit = f" [{study.unit}]" if study.unit else ""
    name = f"MAE on the validation set{unit}"
    drawn = plot(history["epoch"], history["validation_mae"], x_name="epoch", y_name=name)
    return [Said(drawn), Said("")] if drawn else []


def _place(project: Project, study: StudyLook, record: TrialRecord | None = None) -> str:
    """Return where the records lie: a folder, or what a server calls it."""
    place = study.store.place
    if project.paths.storage is not None:
        return place
    return project.paths.show(Path(place, trial_name(record.index)) if record else Path(place))


def _trials(study: StudyLook) -> Table:
    unit = f" [{study.unit}]" if study.unit else ""
    columns = [
        Column("trial"),
        Column("state"),
        Column(f"MAE val{unit}", True),
        Column(f"MAE test{unit}", True),
        Column(f"P90 test{unit}", True, 3),
        Column("epochs", True, 4),
        Column("took", True, 2),
        Column("chosen by", spare=5),
        Column("hyperparameters", spare=1),
    ]
    ordered = sorted(study.records, key=lambda r: (r.state != "complete", r.value or float("inf"), r.index))
    rows = []
    for record in ordered[:N_TRIALS]:
        searched = {name.removeprefix("log2_"): None for name in record.params}
        rows.append(
            [
                Said(trial_name(record.index), "strong" if record is study.best else ""),
                Said(record.state, "" if record.state == "complete" else "dim"),
                *(error(record.metrics.get(name)) for name in ("val/mae", "test/mae", "test/p90")),
                record.n_epochs,
                format_seconds(record.wall_s),
                record.origin,
                _settings({name: record.config.get(name) for name in searched}),
            ]
        )
    left = len(ordered) - len(rows)
    title = "" if left == 0 else f"the best {len(rows)} of {len(ordered)} trials"
    return Table(title, columns, rows, is_dense=True)
