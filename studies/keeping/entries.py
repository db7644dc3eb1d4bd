"""Descriptions of studies that an earlier version of the program left without one."""

import re
from pathlib import Path

from studies.keeping.stores import DAMAGE
from studies.paths import ProjectPaths
from studies.report.wording import count
from studies.stages.pipeline import read_json
from studies.tuning.champion import CHAMPION_FILE
from studies.tuning.trial_record import TrialRecord, finished_indices, read_record
from studies.tuning.trial_store import StudyEntry, open_trials
from studies.tuning.trial_store_files import ENTRY_FILE

_FOLDER = re.compile(r"(?P<size>n\d{4,})-(?P<digits>[0-9a-f]{8})")


def undescribed(paths: ProjectPaths) -> list[Path]:
    """Return folders of trials that no description stands beside: nothing lists their studies."""
    found = []
    for folder in sorted((paths.mlruns / "trials").glob("*/n*-*/")):
        is_study = _FOLDER.fullmatch(folder.name) and finished_indices(folder)
        if is_study and not (folder / ENTRY_FILE).is_file():
            found.append(folder)
    return found


def describe(paths: ProjectPaths, folder: Path) -> str:
    """Write the description of a study from its trials, its champion and the manifest of its tuning."""
    match = _FOLDER.fullmatch(folder.name)
    assert match is not None
    label, n_train = folder.parent.name, int(match["size"][1:])
    name = f"{label}/{match['size']}/{match['digits']}"
    records = _readable(folder)
    if not records:
        return f"{name}: none of its trials can be read"
    champion = read_json(paths.champion(label, n_train) / CHAMPION_FILE) or {}
    manifest = read_json(paths.results(label) / "tune.json") or {}
    tuning = manifest.get("inputs", {}).get("tuning", {})
    entry = StudyEntry(
        name=name,
        label=label,
        case_name=str(champion.get("case_name") or label.rpartition("-")[0] or label),
        n_train=n_train,
        n_planned=max(len(records), int(tuning.get("n_trials", 0))),
        n_parallel=1,
        seed=int(manifest.get("seed", 0)),
        variant=str(tuning.get("variant", "refined")),
        output_unit=str(champion.get("output_unit", "1")),
        digests=dict(records[0].digests),
        note=str(champion.get("note", "")),
        created_s=min(record.started_s for record in records),
    )
    open_trials(paths, name).describe(entry)
    return f"{name}: described from {count(len(records), 'trial')}"


def _readable(folder: Path) -> list[TrialRecord]:
    found = []
    for index in finished_indices(folder):
        try:
            record = read_record(folder, index)
        except DAMAGE:
            continue
        if record is not None:
            found.append(record)
    return found
