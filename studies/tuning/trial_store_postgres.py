"""The records of a study as rows of a PostgreSQL database: the primary key makes each trial finish once."""

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from studies.tuning.claim import Claim
from studies.tuning.postgres import PostgresLock, database
from studies.tuning.trial_record import TrialRecord, best_record, record_from_json, record_to_json
from studies.tuning.trial_store import RunningTrial, StudyEntry

if TYPE_CHECKING:
    from psycopg import Connection


class PostgresTrials:
    """One study's records in a database.

    Args:
        storage: URL of the database.
        name: name of the study.

    Raises:
        InputError: the database cannot be used.
    """

    def __init__(self, storage: str, name: str) -> None:
        self.name = name
        self._storage = storage
        self._database = database(storage)
        self._known: dict[int, TrialRecord] = {}

    @property
    def place(self) -> str:
        """Where the records lie."""
        return f"{self._database.shown}, study {self.name}"

    def entry(self) -> StudyEntry | None:
        """Return what is known of the study."""
        found = self._database.rows(
            "select entry::text, created from studies.studies where name = %s", [self.name]
        )
        return _entry(*found[0]) if found else None

    def describe(self, entry: StudyEntry) -> None:
        """Keep what is known of the study."""
        self._database.rows(
            "insert into studies.studies (name, label, n_train, entry, created) values (%s, %s, %s, %s, %s) "
            "on conflict (name) do update set entry = excluded.entry",
            [
                self.name,
                entry.label,
                entry.n_train,
                json.dumps(entry.to_dict()),
                datetime.fromtimestamp(entry.created_s, UTC),
            ],
        )

    def finished(self) -> list[int]:
        """Return the indices of the finished trials."""
        found = self._database.rows(
            "select index from studies.trials where study = %s order by index", [self.name]
        )
        return [index for (index,) in found]

    def records(self) -> list[TrialRecord]:
        """Read all finished trials; those read before are not fetched again."""
        finished = self.finished()
        unknown = [index for index in finished if index not in self._known]
        if unknown:
            found = self._database.rows(
                "select index, record::text from studies.trials where study = %s and index = any(%s)",
                [self.name, unknown],
            )
            self._known |= {index: record_from_json(text) for index, text in found}
        return [self._known[index] for index in finished if index in self._known]

    def record(self, index: int) -> TrialRecord | None:
        """Read a finished trial."""
        found = self._database.rows(
            "select record::text from studies.trials where study = %s and index = %s", [self.name, index]
        )
        return record_from_json(found[0][0]) if found else None

    def write(
        self, record: TrialRecord, history: Mapping[str, NDArray[Any]], surrogate: Path | None = None
    ) -> bool:
        """Keep a finished trial and forget its claim, in one step."""
        curves = io.BytesIO()
        np.savez_compressed(curves, allow_pickle=False, **{k: np.asarray(v) for k, v in history.items()})
        weights = None if surrogate is None else _packed(surrogate)
        row = [self.name, record.index, record_to_json(record), curves.getvalue(), weights]

        def insert(connection: "Connection") -> str:
            with connection.transaction():
                connection.execute(
                    "insert into studies.trials (study, index, record, history, surrogate) "
                    "values (%s, %s, %s, %s, %s) on conflict do nothing",
                    row,
                )
                connection.execute(
                    "delete from studies.claims where study = %s and index = %s", [self.name, record.index]
                )
                kept = connection.execute(
                    "select record::text from studies.trials where study = %s and index = %s",
                    [self.name, record.index],
                ).fetchone()
            return "" if kept is None else str(kept[0])

        # The first answer may have been lost with the connection: what lies there tells whose it is.
        kept = record_from_json(self._database.run(insert))
        return (kept.started_s, kept.owner) == (record.started_s, record.owner)

    def history(self, index: int) -> dict[str, NDArray[Any]]:
        """Read a trial's learning curves."""
        found = self._database.rows(
            "select history from studies.trials where study = %s and index = %s", [self.name, index]
        )
        if not found:
            raise KeyError(f"{self.name} has no finished trial {index}")
        with np.load(io.BytesIO(found[0][0]), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def fetch_surrogate(self, index: int, folder: Path) -> bool:
        """Copy a trial's saved surrogate into an existing folder."""
        found = self._database.rows(
            "select surrogate from studies.trials where study = %s and index = %s", [self.name, index]
        )
        if not found or found[0][0] is None:
            return False
        with zipfile.ZipFile(io.BytesIO(found[0][0])) as packed:
            packed.extractall(folder)
        return True

    def keep_only_best(self) -> None:
        """Remove the surrogates of all finished trials but the best."""
        records = self.records()
        best = best_record(records)
        others = [record.index for record in records if record is not best]
        self._database.rows(
            "update studies.trials set surrogate = null "
            "where study = %s and index = any(%s) and surrogate is not null",
            [self.name, others],
        )

    def running(self) -> list[RunningTrial]:
        """Return the trials that have an owner."""
        found = self._database.rows(
            "select claim::text, epoch, value, heard from studies.claims "
            "where study = %s and token <> '' order by index",
            [self.name],
        )
        running = []
        for text, epoch, value, heard in found:
            claim = Claim(**json.loads(text))
            running.append(
                RunningTrial(
                    index=claim.index,
                    owner=claim.owner,
                    started_s=claim.started_s,
                    epoch=epoch,
                    max_epochs=claim.max_epochs,
                    value=value,
                    heard_s=heard.timestamp(),
                    attempt=claim.attempt,
                )
            )
        return running

    def lock(self) -> PostgresLock:
        """Return the lock under which trials are claimed."""
        return PostgresLock(self._storage, f"claims/{self.name}")

    def claims(self) -> list[tuple[Claim, float]]:
        """Return every claim and how long its owner has been silent, by the server's clock."""
        found = self._database.rows(
            "select claim::text, extract(epoch from clock_timestamp() - heard)::float8 from studies.claims "
            "where study = %s order by index",
            [self.name],
        )
        return [(Claim(**json.loads(text)), float(silence)) for text, silence in found]

    def put_claim(self, claim: Claim) -> None:
        """Keep a claim in the place of the trial's former one."""
        self._database.rows(
            "insert into studies.claims (study, index, claim, token) values (%s, %s, %s, %s) "
            "on conflict (study, index) do update set claim = excluded.claim, token = excluded.token, "
            "epoch = 0, value = null, heard = now()",
            [self.name, claim.index, json.dumps(claim.to_dict()), claim.token],
        )

    def drop_claim(self, index: int) -> None:
        """Forget a claim."""
        self._database.rows("delete from studies.claims where study = %s and index = %s", [self.name, index])

    def beat(self, claim: Claim, *, epoch: int, value: float | None) -> None:
        """Note that a claim's owner lives, and how far the trial is."""
        self._database.rows(
            "update studies.claims set epoch = %s, value = %s, heard = now() "
            "where study = %s and index = %s and token = %s",
            [epoch, value, self.name, claim.index, claim.token],
        )


def postgres_studies(storage: str) -> list[StudyEntry]:
    """Return all studies of a database.

    Raises:
        InputError: the database cannot be used.
    """
    found = database(storage).rows("select entry::text, created from studies.studies")
    return [_entry(text, created) for text, created in found]


def _entry(text: str, created: datetime) -> StudyEntry:
    known = {one.name for one in fields(StudyEntry)}
    content = {name: value for name, value in json.loads(text).items() if name in known}
    return replace(StudyEntry(**content), created_s=created.timestamp())


def _packed(folder: Path) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for file in sorted(folder.iterdir()):
            archive.write(file, file.name)
    return packed.getvalue()
