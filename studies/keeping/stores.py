"""What the stores hold at this moment: the studies with their records, damaged ones among them."""

import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from studies.keeping.recorded_study import RecordedStudy, recorded_study
from studies.paths import ProjectPaths
from studies.tuning.claim import Claim, is_dead
from studies.tuning.trial_record import TrialRecord, best_record
from studies.tuning.trial_store import StudyEntry, TrialStore, list_studies, open_trials

OnProgress = Callable[[int, int], None]
DAMAGE = (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, AttributeError)
"""What readers of JSON and NPZ raise of a file that is not what was written."""


@dataclass(frozen=True)
class KeptStudy:
    """A study with its records.

    Args:
        paths: the project.
        entry: what is known of it.
        store: its records.
        records: its finished trials, ordered by index.
        damaged: indices of the trials whose record cannot be read, each with the reason.
        claims: who works on it, and for how long nobody has heard of them. [s]
    """

    paths: ProjectPaths
    entry: StudyEntry
    store: TrialStore
    records: tuple[TrialRecord, ...]
    damaged: tuple[tuple[int, str], ...]
    claims: tuple[tuple[Claim, float], ...]

    @property
    def name(self) -> str:
        """Its name."""
        return self.entry.name

    @cached_property
    def best(self) -> TrialRecord | None:
        """Its completed trial of least validation error."""
        return best_record(self.records)

    @cached_property
    def spec(self) -> RecordedStudy:
        """The study as views of it need it."""
        return recorded_study(self.paths, self.entry, self.records)

    @cached_property
    def dead_claims(self) -> tuple[Claim, ...]:
        """Claims whose owners are no more."""
        return tuple(
            claim for claim, silence in self.claims if claim.is_owned and is_dead(claim.owner, silence)
        )

    @property
    def is_busy(self) -> bool:
        """Whether somebody works on it."""
        return sum(claim.is_owned for claim, _ in self.claims) > len(self.dead_claims)


@dataclass(frozen=True)
class Stores:
    """All studies of a project.

    Args:
        paths: where everything lies.
        studies: the studies, by label and size.
    """

    paths: ProjectPaths
    studies: tuple[KeptStudy, ...]

    @cached_property
    def by_name(self) -> dict[str, KeptStudy]:
        """The studies by their names."""
        return {study.name: study for study in self.studies}


def read_stores(paths: ProjectPaths, on_progress: OnProgress = lambda done, total: None) -> Stores:
    """Read all records.

    Args:
        paths: the project.
        on_progress: told of studies read, and how many there are.

    Raises:
        InputError: the storage cannot be reached.
    """
    entries = list_studies(paths)
    studies = []
    for done, entry in enumerate(entries):
        on_progress(done, len(entries))
        studies.append(read_study(paths, entry))
    return Stores(paths, tuple(studies))


def read_study(paths: ProjectPaths, entry: StudyEntry) -> KeptStudy:
    """Read the records of one study, each by itself where one of them is damaged."""
    store = open_trials(paths, entry.name)
    claims = tuple(store.claims())
    damaged: list[tuple[int, str]] = []
    try:
        records = store.records()
        if any(record.study != entry.name for record in records):
            raise ValueError("a record of another study")
    except DAMAGE:
        records = []
        for index in store.finished():
            try:
                record = store.record(index)
            except DAMAGE as error:
                why = error.__cause__ or error
                damaged.append((index, f"{type(why).__name__}: {why}"))
                continue
            if record is None:
                damaged.append((index, "no trial.json"))
            elif record.study != entry.name:
                damaged.append((index, f"it is a record of {record.study}"))
            else:
                records.append(record)
    else:
        known = {record.index for record in records}
        damaged = [(index, "no trial.json") for index in store.finished() if index not in known]
    return KeptStudy(paths, entry, store, tuple(records), tuple(damaged), claims)
