"""The records of a study as plain files: a folder per finished trial, a small file per running one."""

import json
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from simulation.errors import InputError
from simulation.file_lock import FileLock
from studies.tuning.claim import Claim
from studies.tuning.trial_record import (
    SURROGATE_FOLDER,
    TrialRecord,
    best_record,
    finished_indices,
    read_history,
    read_record,
    trial_name,
    write_json,
    write_record,
)
from studies.tuning.trial_store import RunningTrial, StudyEntry

ENTRY_FILE = "study.json"
RUNNING_FOLDER = "running"
_GONE = ".surrogate"


class FileTrials:
    """One study's records below `mlruns/trials`.

    Args:
        mlruns: the project's folder of everything a run leaves behind.
        name: name of the study.
    """

    def __init__(self, mlruns: Path, name: str) -> None:
        self.name = name
        self.folder = study_folder(mlruns, name)
        self._running = self.folder / RUNNING_FOLDER
        self._known: dict[int, TrialRecord] = {}

    @property
    def place(self) -> str:
        """Where the records lie."""
        return str(self.folder)

    def entry(self) -> StudyEntry | None:
        """Return what is known of the study."""
        return _read_entry(self.folder / ENTRY_FILE)

    def describe(self, entry: StudyEntry) -> None:
        """Keep what is known of the study."""
        before = self.entry()
        if before is not None:
            entry = replace(entry, created_s=before.created_s)
        if entry != before:
            write_json(self.folder / ENTRY_FILE, entry.to_dict())

    def finished(self) -> list[int]:
        """Return the indices of the finished trials."""
        return finished_indices(self.folder)

    def records(self) -> list[TrialRecord]:
        """Read all finished trials; those read before are not read again."""
        finished = self.finished()
        for index in finished:
            if index not in self._known and (record := self.record(index)) is not None:
                self._known[index] = record
        return [self._known[index] for index in finished if index in self._known]

    def record(self, index: int) -> TrialRecord | None:
        """Read a finished trial."""
        return read_record(self.folder, index)

    def write(
        self, record: TrialRecord, history: Mapping[str, NDArray[Any]], surrogate: Path | None = None
    ) -> bool:
        """Keep a finished trial and forget its claim."""
        is_new = self.record(record.index) is None
        if is_new:
            write_record(self.folder, record, history, surrogate)
        self.drop_claim(record.index)
        return is_new

    def history(self, index: int) -> dict[str, NDArray[Any]]:
        """Read a trial's learning curves."""
        try:
            return read_history(self.folder, index)
        except FileNotFoundError:
            raise KeyError(f"{self.name} has no finished trial {index}") from None

    def fetch_surrogate(self, index: int, folder: Path) -> bool:
        """Copy a trial's saved surrogate into an existing folder."""
        source = self.folder / trial_name(index) / SURROGATE_FOLDER
        if not source.is_dir():
            return False
        try:
            shutil.copytree(source, folder, dirs_exist_ok=True)
        except (FileNotFoundError, shutil.Error):
            if source.is_dir():
                raise
            # Another process has found a better one meanwhile.
            for copied in folder.iterdir():
                copied.unlink()
            return False
        return True

    def keep_only_best(self) -> None:
        """Remove the surrogates of all finished trials but the best."""
        # Only those of trials that were compared: another process may finish a better one right now.
        records = self.records()
        best = best_record(records)
        for record in records:
            if record is not best:
                # At once: who copies it gets all of it or an error.
                folder = self.folder / trial_name(record.index)
                shutil.rmtree(folder / _GONE, ignore_errors=True)
                with suppress(OSError):
                    (folder / SURROGATE_FOLDER).rename(folder / _GONE)
                shutil.rmtree(folder / _GONE, ignore_errors=True)

    def running(self) -> list[RunningTrial]:
        """Return the trials that have an owner."""
        found = []
        for claim, beat in self._claims():
            if claim.is_owned:
                found.append(
                    RunningTrial(
                        index=claim.index,
                        owner=claim.owner,
                        started_s=claim.started_s,
                        epoch=int(beat.get("epoch", 0)),
                        max_epochs=claim.max_epochs,
                        value=beat.get("value"),
                        heard_s=float(beat.get("heard_s", claim.started_s)),
                        attempt=claim.attempt,
                    )
                )
        return found

    def lock(self) -> FileLock:
        """Return the lock under which trials are claimed."""
        return FileLock(self.folder / ".lock")

    def claims(self) -> list[tuple[Claim, float]]:
        """Return every claim and how long its owner has been silent."""
        now = time.time()
        return [(claim, now - float(beat.get("heard_s", claim.started_s))) for claim, beat in self._claims()]

    def put_claim(self, claim: Claim) -> None:
        """Keep a claim in the place of the trial's former one."""
        write_json(self._claim_file(claim.index), claim.to_dict())

    def drop_claim(self, index: int) -> None:
        """Forget a claim."""
        for file in (self._claim_file(index), self._beat_file(index)):
            file.unlink(missing_ok=True)

    def beat(self, claim: Claim, *, epoch: int, value: float | None) -> None:
        """Note that a claim's owner lives, and how far the trial is; without effect once it has lost it."""
        present = _read(self._claim_file(claim.index))
        if present is None or present.get("token") != claim.token:
            return
        said = {"token": claim.token, "epoch": epoch, "value": value, "heard_s": time.time()}
        write_json(self._beat_file(claim.index), said)

    def _claims(self) -> Iterator[tuple[Claim, dict[str, Any]]]:
        if not self._running.is_dir():
            return
        found = [Claim(**content) for content in map(_read, self._running.glob("t*.json")) if content]
        for claim in sorted(found, key=lambda claim: claim.index):
            if self.record(claim.index) is not None:  # its owner died between its record and its claim
                continue
            beat = _read(self._beat_file(claim.index)) or {}
            yield claim, beat if beat.get("token") == claim.token else {}

    def _claim_file(self, index: int) -> Path:
        return self._running / f"{trial_name(index)}.json"

    def _beat_file(self, index: int) -> Path:
        return self._running / f"{trial_name(index)}.beat"


def study_folder(mlruns: Path, name: str) -> Path:
    """Return the folder of a study's finished trials.

    Raises:
        InputError: the name is no study's.
    """
    parts = name.split("/")
    if len(parts) != 3 or not all(parts) or ".." in parts:
        raise InputError(f"{name!r} is no name of a study; one is like office-quick/n0064/1a2b3c4d")
    label, size, digest = parts
    return mlruns / "trials" / label / f"{size}-{digest}"


def file_studies(mlruns: Path) -> list[StudyEntry]:
    """Return the studies that have an entry below `mlruns/trials`."""
    files = (mlruns / "trials").glob(f"*/*/{ENTRY_FILE}")
    return [entry for entry in map(_read_entry, files) if entry is not None]


def _read_entry(file: Path) -> StudyEntry | None:
    content = _read(file)
    if content is None or "name" not in content:
        return None
    known = {field.name for field in fields(StudyEntry)}
    return StudyEntry(**{name: value for name, value in content.items() if name in known})


def _read(file: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return content if isinstance(content, dict) else None
