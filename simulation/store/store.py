"""Every simulated row of one model, kept once: one SQLite file that the processes of a machine may share.

Two tables, both for readers as well: `model` has one row that says whose rows these are, `simulations` has
one row per simulation. An output is a blob of doubles, one per time; parameters are columns, and beside them
`_theta` holds their exact bytes, by which a row is known. `_first` is 1 where no row before it in its process
can have changed its answer. The database's `user_version` is 1 once rows of one process were found to depend
on each other: from then on each has a process of its own.
"""

import json
import os
import sqlite3
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import InputError, MachineError
from simulation.file_lock import FileLock
from simulation.foreign_text import quoted
from simulation.trajectories import Trajectories
from simulation.write_gate import check_database

BLOCK_BYTES = 64 * 2**20
"""Outputs that a stream holds at once."""
_FORMAT = 1
_PATIENCE_S = 60.0  # for another process that writes; a chunk is written in milliseconds
_NEVER = 2**63 - 1  # the largest row number of SQLite
_OWN_COLUMNS = ("_id", "_theta", "_failure", "_written", "_check", "_first")
_DAMAGED = "it is damaged: remove it, with -wal and -shm beside it, and its simulations run again"
_NOT_WRITTEN = "allow writing there, then type the command again"
_REMEDIES = {
    sqlite3.SQLITE_FULL: "free some space, then type the command again: what is stored is kept",
    sqlite3.SQLITE_IOERR: "see to the disk, then type the command again: what is stored is kept",
    sqlite3.SQLITE_CORRUPT: _DAMAGED,
    sqlite3.SQLITE_NOTADB: _DAMAGED,
    sqlite3.SQLITE_BUSY: "another process writes to it; wait, then type the command again",
    sqlite3.SQLITE_READONLY: _NOT_WRITTEN,
    sqlite3.SQLITE_CANTOPEN: _NOT_WRITTEN,
}


class SimulationStore:
    """The rows of one model on disk.

    A row is known by the exact bytes of its parameters. Failed rows are rows; a good row for the same
    parameters takes their place, and so does a newer failed one. Rows are numbered as they are written.
    Whatever SQLite complains of is a MachineError of one line.

    Attributes:
        file: Where the rows lie.
        names: Names of the p parameters and of the k outputs.
        time: Output times. Shape (t,). [s]
    """

    def __init__(
        self,
        file: Path,
        *,
        model_digest: str,
        parameter_names: tuple[str, ...],
        output_names: tuple[str, ...],
        time: FloatArray,
    ) -> None:
        """Open a store; it is made when missing.

        Args:
            file: Where the rows lie; one file per model.
            model_digest: Digest of all that decides what the model answers to given parameters.
            parameter_names: Names of the p parameters.
            output_names: Names of the k outputs.
            time: Output times. Shape (t,). [s]

        Raises:
            InputError: If the file belongs to another model or to another version of this program.
        """
        self.file = Path(file)
        self.names = tuple(parameter_names), tuple(output_names)
        self.time = np.ascontiguousarray(time, dtype="<f8")
        self._model = zlib.crc32(model_digest.encode())
        outputs, parameters = _columns(parameter_names, output_names)
        self._read = f"select _check, _failure, {', '.join(outputs)} from simulations where _theta = ?"
        columns = ", ".join(["_theta", "_failure", "_check", "_first", *parameters, *outputs])
        values = ", ".join("?" * (4 + len(parameters + outputs)))
        self._insert = (
            f"insert or ignore into simulations (_written, {columns}) "
            f"values (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'), {values})"
        )
        described: dict[str, object] = {
            "format": _FORMAT,
            "model_digest": model_digest,
            "parameters": json.dumps(parameter_names),
            "outputs": json.dumps(output_names),
            "time_s": json.dumps(self.time.tolist()),
        }
        if not self.file.exists():
            _make(self.file, described, [*(f"{name} real" for name in parameters), *outputs])
        _check_model(self.file, described)
        self._database = _connect(self.file)
        with _in_words(self.file):
            _add_first(self._database)

    @classmethod
    def at(cls, file: Path) -> "SimulationStore":
        """Open a store that exists.

        Args:
            file: Where the rows lie.

        Raises:
            InputError: If there is none.
        """
        if not Path(file).is_file():
            raise InputError(f"{file}: no simulations are stored there; type: studies simulate")
        with _in_words(file), closing(_connect(file)) as database:
            _, digest, parameters, outputs, time = _model_of(database)
            return cls(
                file,
                model_digest=digest,
                parameter_names=tuple(json.loads(parameters)),
                output_names=tuple(json.loads(outputs)),
                time=np.array(json.loads(time)),
            )

    @property
    def theta(self) -> FloatArray:
        """Parameters of all rows, in the order of writing. Shape (n, p). [per parameter]."""
        with _in_words(self.file):
            rows = sorted(self._database.execute("select _id, _theta from simulations"))
        whole = np.frombuffer(b"".join(key for _, key in rows), dtype="<f8")
        return whole.reshape(len(rows), len(self.names[0])).astype(np.float64)

    @property
    def n_written(self) -> int:
        """Number of the row that was written last, 0 for none."""
        with _in_words(self.file):
            found = self._database.execute("select max(_id) from simulations").fetchone()
        return int(found[0] or 0)

    def find(self, theta: FloatArray, *, failed_after: int = 0) -> BoolArray:
        """Return which rows are stored.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            failed_after: Number of a row, see `n_written`; failed rows count if they were written later.

        Returns:
            Shape (n,).
        """
        select = "select exists (select 1 from simulations where _theta = ? and (_id > ? or _failure = ''))"
        with _in_words(self.file):
            found = [self._database.execute(select, (key, failed_after)).fetchone() for key in _keys(theta)]
        return np.array(found, dtype=np.bool_).reshape(len(theta))

    def find_good(self, theta: FloatArray) -> BoolArray:
        """Return which rows are stored and did not fail. Shapes (n, p) and (n,)."""
        return self.find(theta, failed_after=_NEVER)

    def read(self, theta: FloatArray) -> Trajectories:
        """Read rows.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The rows in the order asked for, exactly as the model answered.

        Raises:
            LookupError: If a row is not stored.
            MachineError: If a row is not what was written: it is removed, to be simulated again.
        """
        keys, failures, damaged = _keys(theta), list[str](), set[bytes]()
        y = np.empty((len(keys), len(self.time), len(self.names[1])))
        with _in_words(self.file):
            for i, key in enumerate(keys):
                found = self._database.execute(self._read, (key,)).fetchone()
                if found is None:
                    n_missing = int((~self.find(theta)).sum())
                    raise LookupError(f"{n_missing} of {len(keys)} rows are not in {self.file}")
                check, failure, *outputs = found
                if check != self._sum(key, failure, *outputs):
                    damaged.add(key)
                    continue
                failures.append(failure)
                for k, values in enumerate(outputs):
                    y[i, :, k] = np.frombuffer(values, dtype="<f8")
        if damaged:
            with self._writing() as database:
                database.executemany("delete from simulations where _theta = ?", [(key,) for key in damaged])
            raise MachineError(
                f"{self.file}: {len(damaged)} of {len(keys)} simulations were damaged and are removed; type "
                "the command again to repeat them"
            )
        return Trajectories(np.array(theta, dtype=np.float64), y, self.time, *self.names, tuple(failures))

    def stream(self, theta: FloatArray) -> Iterator[Trajectories]:
        """Read rows block by block, in bounded memory.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Yields:
            Consecutive blocks; see `read` for what it raises.
        """
        size = max(1, BLOCK_BYTES // max(1, 8 * len(self.time) * len(self.names[1])))
        for start in range(0, len(theta), size):
            yield self.read(theta[start : start + size])

    def first(self, theta: FloatArray) -> BoolArray:
        """Return which rows are stored and were the first of their process.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        select = "select exists (select 1 from simulations where _theta = ? and _first = 1)"
        with _in_words(self.file):
            found = [self._database.execute(select, (key,)).fetchone() for key in _keys(theta)]
        return np.array(found, dtype=np.bool_).reshape(len(theta))

    @property
    def theta_reused(self) -> FloatArray:
        """Parameters of good rows that came after others in a process. Shape (n, p). [per parameter]."""
        select = "select _theta from simulations where _failure = '' and _first is not 1 order by _id"
        with _in_words(self.file):
            rows = self._database.execute(select).fetchall()
        whole = np.frombuffer(b"".join(key for (key,) in rows), dtype="<f8")
        return whole.reshape(len(rows), len(self.names[0])).astype(np.float64)

    @property
    def is_reuse_given_up(self) -> bool:
        """Whether rows of one process were found to depend on each other, see `give_up_reuse`."""
        with _in_words(self.file):
            return bool(self._database.execute("pragma user_version").fetchone()[0])

    def give_up_reuse(self) -> int:
        """Remove all rows that came after others in a process, and remember that none may again.

        Returns:
            How many are removed.
        """
        with self._writing() as database:
            database.execute("pragma user_version = 1")
            return database.execute("delete from simulations where _first is not 1").rowcount

    def append(self, rows: Trajectories, is_first: BoolArray | None = None) -> None:
        """Store rows, all or none; when this returns they survive the death of process and machine.

        Args:
            rows: Answers of this store's model.
            is_first: Which of them were the first of their process; None for all. Shape (n,).

        Raises:
            ValueError: If they are another model's.
        """
        names = rows.parameter_names, rows.output_names
        if names != self.names or not np.array_equal(rows.time, self.time):
            raise ValueError("these rows have other names or times than the store")
        y = np.asarray(rows.y, dtype="<f8")
        first = np.ones(rows.n, dtype=np.bool_) if is_first is None else is_first
        if rows.n:
            with self._writing() as database:
                for i, (key, reason) in enumerate(zip(_keys(rows.theta), rows.failures, strict=True)):
                    # What an FMU says may be in any encoding.
                    failure = reason.encode("utf-8", "backslashreplace").decode("utf-8")
                    outputs = [values.tobytes() for values in y[i].T]
                    check = self._sum(key, failure, *outputs)
                    database.execute("delete from simulations where _theta = ? and _failure <> ''", (key,))
                    own = key, failure, check, int(first[i])
                    database.execute(self._insert, (*own, *rows.theta[i].tolist(), *outputs))

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def __enter__(self) -> "SimulationStore":
        """Return the store."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the store."""
        self.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        with _in_words(self.file), self._database as database:
            database.execute("begin immediate")
            yield database

    def _sum(self, *values: object) -> int:
        """Return the CRC-32 of what a row says, of any type where it is damaged, and of which model."""
        parts = [value if isinstance(value, bytes) else str(value).encode() for value in values]
        return zlib.crc32(b"".join(parts), self._model)


def _keys(theta: FloatArray) -> list[bytes]:
    """Return each row's exact bytes."""
    return [row.tobytes() for row in np.asarray(theta, dtype="<f8")]


def _connect(file: Path) -> sqlite3.Connection:
    check_database(file)
    is_fixed = not os.access(file.parent, os.W_OK) and not file.with_name(f"{file.name}-wal").exists()
    # Where nothing can be written, SQLite's files beside it cannot be made; no other process writes either.
    place = f"{file.absolute().as_uri()}{'?immutable=1' if is_fixed else ''}"
    database = sqlite3.connect(place, uri=True, timeout=_PATIENCE_S, isolation_level=None)
    database.text_factory = _decoded
    return database


def _decoded(raw: bytes) -> str:
    # A damaged text has another checksum: it need not stop the reading of others.
    return raw.decode("utf-8", "replace")


def _make(file: Path, described: dict[str, object], columns: list[str]) -> None:
    """Make a store without rows, whole or not at all, unless another process just did."""
    check_database(file)
    with (
        FileLock(file.parent / ".making"),
        tempfile.TemporaryDirectory(prefix=".", dir=file.parent) as folder,
    ):
        if file.exists():
            return
        made = Path(folder) / file.name
        with _in_words(file), closing(_connect(made)) as database:
            # What is committed is safe at once, and readers do not wait for writers.
            database.execute("pragma journal_mode = wal")
            database.execute(f"create table model ({', '.join(described)})")
            database.execute("insert into model values (?, ?, ?, ?, ?)", tuple(described.values()))
            # Outputs lie at a row's end: what is before them is found without reading them.
            database.execute(
                "create table simulations (_id integer primary key autoincrement, "
                "_theta blob unique, _failure text, _written text, _check integer, _first integer, "
                f"{', '.join(columns)})"
            )
        for rest in ("-wal", "-shm"):
            # SQLite would add what a killed process left beside a file that was removed since.
            file.with_name(file.name + rest).unlink(missing_ok=True)
        made.rename(file)


def _add_first(database: sqlite3.Connection) -> None:
    """Give a store of an earlier version the column `_first`: nothing is known of its rows."""
    columns = "select 1 from pragma_table_info('simulations') where name = '_first'"
    if database.execute(columns).fetchone() is not None:
        return
    try:
        with database:
            database.execute("begin immediate")
            if database.execute(columns).fetchone() is None:
                database.execute("alter table simulations add column _first integer")
    except sqlite3.OperationalError as error:
        # Where nothing can be written, rows are only read.
        if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_READONLY:
            raise


def _model_of(database: sqlite3.Connection) -> tuple[Any, ...]:
    # None where that row is damaged.
    return tuple(database.execute("select * from model").fetchone() or ())


def _check_model(file: Path, described: dict[str, object]) -> None:
    with _in_words(file), closing(_connect(file)) as database:
        for (key, wanted), found in zip(described.items(), _model_of(database), strict=True):
            if found != wanted:
                raise InputError(
                    f"{file}: {key} is {quoted(found)}, this model has {quoted(wanted)}; remove the file or "
                    "name another one"
                )


def _columns(parameter_names: Iterable[str], output_names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return the columns of outputs and parameters, as SQL quotes them.

    SQL takes "C" and "c" for one name, and an initial state may have the name of an output: the later one has
    underscores before it.
    """
    taken = set(_OWN_COLUMNS)

    def free(name: str) -> str:
        while name.casefold() in taken:
            name = f"_{name}"
        taken.add(name.casefold())
        return '"{}"'.format(name.replace('"', '""'))

    return [free(name) for name in output_names], [free(name) for name in parameter_names]


@contextmanager
def _in_words(file: Path) -> Iterator[None]:
    """Turn SQLite's errors about a file into one line with a remedy."""
    try:
        yield
    except (InputError, sqlite3.ProgrammingError):
        raise
    except (sqlite3.DatabaseError, ValueError) as error:
        number = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
        remedy = _REMEDIES.get(number & 0xFF, "it holds no simulations: move it away")
        raise MachineError(f"{file}: {error}; {remedy}") from error
