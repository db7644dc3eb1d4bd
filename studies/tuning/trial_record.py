"""The durable record of a finished trial: a folder of plain files, written whole or not at all."""

import json
import math
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.errors import InputError
from simulation.whole_file import whole_file
from studies.tuning.study_spec import StudySpec, StudySummary, TrialState

RECORD_FILE = "trial.json"
HISTORY_FILE = "history.npz"
SURROGATE_FOLDER = "surrogate"


@dataclass(frozen=True)
class TrialRecord:
    """One finished trial.

    Args:
        study: name of the study.
        n_train: training-set size.
        index: place in the study, from 0; interrupted attempts do not count.
        state: how it ended.
        reason: why it failed, was pruned or stopped.
        params: the hyperparameters that were searched.
        config: all settings of the surrogate.
        seed: seed of the training.
        started_s: start of the trial. [s since 1970, UTC]
        wall_s: duration of the training. [s]
        digests: sha256 of the case, FMU and data sets.
        owner: host, process and its start.
        origin: why these hyperparameters, for example "default", "random" or "gp".
        attempts: how often it was begun; more than 1 where it was interrupted.
        environment: what it was trained with: git commit, versions, platform, threads.
        metrics: errors by name (`val/mae`, ...); a pruned trial has `val/mae` only. [output's unit]
        reports: validation error at the epochs where trials are compared. [output's unit]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept.
        n_rows: training rows used, failed simulations left out.
        weights_sha256: of the trained surrogate's weights, "" without one; weights are not kept for ever.
    """

    study: str
    n_train: int
    index: int
    state: TrialState
    reason: str
    params: dict[str, float | int]
    config: dict[str, Any]
    seed: int
    started_s: float
    wall_s: float
    digests: dict[str, str]
    owner: dict[str, Any]
    origin: str = ""
    attempts: int = 1
    environment: dict[str, str] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)
    reports: dict[str, float] = field(default_factory=dict)
    n_epochs: int = 0
    best_epoch: int = 0
    n_rows: int = 0
    weights_sha256: str = ""

    @property
    def key(self) -> str:
        """Name of the trial among all trials of all studies."""
        return f"{self.study}/{trial_name(self.index)}"

    @property
    def value(self) -> float | None:
        """Validation error that the study compares, None for a failed trial. [output's unit]."""
        return self.metrics.get("val/mae")

    @property
    def has_epochs(self) -> bool:
        """Whether its surrogate was learnt epoch by epoch; Gaussian processes are fitted in one piece."""
        return bool(self.config.get("regressor", "network") == "network")

    @property
    def ended_s(self) -> float:
        """End of the trial. [s since 1970, UTC]."""
        return self.started_s + self.wall_s


_FIELDS = frozenset(one.name for one in fields(TrialRecord))


def trial_name(index: int) -> str:
    """Return the folder name of a trial."""
    return f"t{index:03d}"


def write_record(
    study_folder: Path,
    record: TrialRecord,
    history: Mapping[str, NDArray[Any]],
    surrogate: Path | None = None,
) -> Path:
    """Write a trial's folder and put it in place in one step.

    Args:
        study_folder: folder of the study's trials.
        record: what is known of the trial.
        history: learning curves, one array per name, each of shape (epochs validated,).
        surrogate: folder with the saved surrogate.
    """
    final = study_folder / trial_name(record.index)
    scratch = study_folder / f".{final.name}-{os.getpid()}"
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    np.savez_compressed(
        scratch / HISTORY_FILE, allow_pickle=False, **{k: np.asarray(v) for k, v in history.items()}
    )
    if surrogate is not None:
        shutil.copytree(surrogate, scratch / SURROGATE_FOLDER)
    (scratch / RECORD_FILE).write_text(record_to_json(record) + "\n", encoding="utf-8")
    replace_folder(scratch, final)
    return final


def read_record(study_folder: Path, index: int) -> TrialRecord | None:
    """Read a trial, None where there is none.

    Raises:
        InputError: its record is damaged.
    """
    file = study_folder / trial_name(index) / RECORD_FILE
    try:
        return record_from_json(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(
            f"{file}: cannot be read ({type(error).__name__}); studies doctor --repair keeps it aside"
        ) from error


def record_from_json(text: str) -> TrialRecord:
    """Read a record; fields that another version wrote besides are left out."""
    content = {name: value for name, value in json.loads(text).items() if name in _FIELDS}
    for name in ("metrics", "reports"):
        content[name] = {key: float(value) for key, value in content.get(name, {}).items()}
    return TrialRecord(**content)


def record_to_json(record: TrialRecord) -> str:
    """Write a record; numbers that JSON does not know ("nan", "inf") become texts."""
    content = asdict(record)
    for name in ("metrics", "reports"):
        content[name] = {
            key: value if math.isfinite(value) else str(value) for key, value in content[name].items()
        }
    return json.dumps(content, indent=1, sort_keys=True, allow_nan=False)


def finished_indices(study_folder: Path) -> list[int]:
    """Return the indices of all finished trials of a study, ascending; there may be gaps."""
    try:
        names = os.listdir(study_folder)  # noqa: PTH208  # an order of magnitude faster than paths
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(int(name[1:]) for name in names if name[0] == "t" and name[1:].isdigit())


def read_records(study_folder: Path) -> list[TrialRecord]:
    """Read all finished trials of a study, ordered by index; there may be gaps."""
    found = (read_record(study_folder, index) for index in finished_indices(study_folder))
    return [record for record in found if record is not None]


def read_history(study_folder: Path, index: int) -> dict[str, NDArray[Any]]:
    """Read a trial's learning curves, each of shape (epochs validated,)."""
    place = study_folder / trial_name(index) / HISTORY_FILE
    with place.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def best_record(records: Sequence[TrialRecord]) -> TrialRecord | None:
    """Return the completed trial of least validation error, the earlier one of equals."""
    complete = [r for r in records if r.state == "complete" and math.isfinite(r.metrics["val/mae"])]
    return min(complete, key=lambda r: (r.metrics["val/mae"], r.index), default=None)


def summarize(spec: StudySpec, records: Sequence[TrialRecord], champion: Path | None) -> StudySummary:
    """Count a study's trials and name its best."""
    best = best_record(records)
    states = [record.state for record in records]
    return StudySummary(
        study=spec.name,
        label=spec.label,
        n_train=spec.n_train,
        n_complete=states.count("complete"),
        n_pruned=states.count("pruned"),
        n_failed=states.count("failed"),
        best_index=best.index if best else None,
        best_metrics=dict(best.metrics) if best else {},
        best_config=dict(best.config) if best else {},
        wall_s=sum(record.wall_s for record in records),
        champion=champion,
    )


def write_json(file: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file in one step."""
    with whole_file(file) as stream:
        stream.write((json.dumps(content, indent=1, sort_keys=True) + "\n").encode())


def replace_folder(new: Path, final: Path) -> None:
    """Put a folder in the place of another; between the two steps the place is empty, never half filled."""
    if final.exists():
        old = final.with_name(f".{final.name}-old-{os.getpid()}")
        shutil.rmtree(old, ignore_errors=True)
        final.rename(old)
        new.rename(final)
        shutil.rmtree(old, ignore_errors=True)
    else:
        final.parent.mkdir(parents=True, exist_ok=True)
        new.rename(final)
