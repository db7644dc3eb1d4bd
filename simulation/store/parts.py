"""One part of a store: an immutable Parquet file of simulated rows; the only module that knows pyarrow."""

import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as compute
import pyarrow.parquet as pq

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.store.rows import CHECK, FAILURE, WRITTEN, Layout, Rows

_DIGEST: Final = b"model_digest"
# Random walks of doubles shrink to three quarters so, as fast as they could be written plainly.
_COMPRESSION: Final = {"compression": "zstd", "compression_level": 1}


class PartDamagedError(Exception):
    """A part, or a row of it, is not what was written."""


@lru_cache(maxsize=4)
def _schema(layout: Layout) -> Any:
    """Return the columns as pyarrow describes them."""
    series = pa.list_(pa.field("element", pa.float64(), nullable=False), len(layout.time))
    fields = [(name, pa.float64()) for name in layout.parameter_columns]
    fields += [(name, series) for name in layout.output_names]
    fields += [(FAILURE, pa.string()), (WRITTEN, pa.timestamp("us", "UTC")), (CHECK, pa.uint32())]
    return pa.schema(
        [pa.field(name, kind, nullable=False) for name, kind in fields],
        metadata={_DIGEST: layout.model_digest.encode()},
    )


def write_part(file: BinaryIO, layout: Layout, blocks: Iterable[Rows]) -> None:
    """Write rows as Parquet.

    Args:
        file: An empty file, open for writing.
        layout: What the rows have in common.
        blocks: The rows; one block is held in memory at a time.
    """
    columns = [*layout.parameter_columns, *(f"{name}.list.element" for name in layout.output_names)]
    with pq.ParquetWriter(
        file,
        _schema(layout),
        use_dictionary=[FAILURE],
        write_statistics=False,
        column_encoding=dict.fromkeys(columns, "BYTE_STREAM_SPLIT"),
        **_COMPRESSION,
    ) as writer:
        for rows in _joined(blocks, layout.rows_per_group):
            writer.write_table(_table(layout, rows), row_group_size=layout.rows_per_group)


def _joined(blocks: Iterable[Rows], least: int) -> Iterator[Rows]:
    """Join small blocks, so that a group of rows is worth reading."""
    waiting: list[Rows] = []
    for block in blocks:
        waiting.append(block)
        if sum(rows.n for rows in waiting) >= least:
            yield Rows.joined(waiting)
            waiting = []
    if waiting:
        yield Rows.joined(waiting)


def _table(layout: Layout, rows: Rows) -> Any:
    found, schema = rows.trajectories, _schema(layout)
    columns = [_plain(column) for column in found.theta.T]
    for k, name in enumerate(layout.output_names):
        values = _plain(found.y[:, :, k])
        columns.append(pa.FixedSizeListArray.from_arrays(values, type=schema.field(name).type))
    columns.append(_texts(found.failures))
    columns.append(_plain(rows.written).view(schema.field(WRITTEN).type))
    columns.append(_plain(rows.checks(layout.model_digest).astype(np.uint32)))
    return pa.table(columns, schema=schema)


class Part:
    """A part on disk, open for reading.

    Every row that is read is checked end to end, from the arrays that were written to the arrays that come
    back: no damaged byte, wherever it lies, becomes a wrong number.
    """

    def __init__(self, path: Path, layout: Layout) -> None:
        """Open a part.

        Args:
            path: The Parquet file.
            layout: What its rows must be.

        Raises:
            FileNotFoundError: If the file is not there any more.
            PartDamagedError: If it cannot be read or belongs to another store.
        """
        self._path, self._layout = path, layout
        with _damage(path):
            self._file = pq.ParquetFile(path, pre_buffer=False)
        try:
            with _damage(path):
                schema, groups = self._file.schema_arrow, range(self._file.num_row_groups)
                sizes = [self._file.metadata.row_group(group).num_rows for group in groups]
                digest = (schema.metadata or {}).get(_DIGEST, b"").decode("utf-8", "replace")
            if digest != layout.model_digest:
                raise PartDamagedError(f"{path}: holds simulations of another model ({digest[:16] or '-'})")
            if not schema.equals(_schema(layout)):
                raise PartDamagedError(f"{path}: its columns are not this store's")
            self._ends = np.cumsum(sizes, dtype=np.int64)
        except BaseException:
            self.close()
            raise

    @property
    def n(self) -> int:
        """Number of rows."""
        return int(self._ends[-1]) if len(self._ends) else 0

    def keys(self) -> tuple[FloatArray, BoolArray, IntArray]:
        """Read what identifies the rows, without their outputs and unchecked.

        Returns:
            Parameters, shape (n, p) [per parameter]; which rows are good, shape (n,); when each was written,
            shape (n,) [µs].
        """
        parameters = self._layout.parameter_columns
        with _damage(self._path):
            table = self._file.read(columns=[*parameters, FAILURE, WRITTEN], use_threads=False)
            theta = np.empty((self.n, len(parameters)))
            for j, name in enumerate(parameters):
                theta[:, j] = _numbers(table[name])
            good = _numbers(compute.binary_length(table[FAILURE])) == 0
            return theta, good, _moments(table[WRITTEN])

    def read(self, rows: npt.NDArray[np.int32]) -> Rows:
        """Read some rows and check each of them.

        Args:
            rows: Their numbers in this part. Shape (m,).

        Returns:
            The rows, in the order asked for.

        Raises:
            PartDamagedError: If any of them is not what was written.
        """
        layout, m = self._layout, len(rows)
        theta = np.empty((m, len(layout.parameter_names)))
        y = np.empty((m, len(layout.time), len(layout.output_names)))
        failures, written = np.empty(m, dtype=object), np.empty(m, dtype=np.int64)
        group_of = np.searchsorted(self._ends, rows, side="right")
        for group in np.unique(group_of):
            here = np.flatnonzero(group_of == group)
            start = int(self._ends[group - 1]) if group else 0
            found = self._group(int(group), rows[here] - start)
            theta[here], y[here] = found.trajectories.theta, found.trajectories.y
            failures[here], written[here] = found.trajectories.failures, found.written
        return Rows(layout.trajectories(theta, y, failures.tolist()), written)

    def blocks(self) -> Iterator[Rows]:
        """Read everything, group by group.

        Raises:
            PartDamagedError: If a row is not what was written.
        """
        for group in range(len(self._ends)):
            yield self._group(group, None)

    def salvage(self) -> Iterator[Rows]:
        """Read what is still good of a damaged part."""
        for group in range(len(self._ends)):
            try:
                rows, intact = self._decode(group, None)
            except PartDamagedError:
                continue
            if intact.any():
                yield rows.take(intact)

    def _group(self, group: int, rows: npt.NDArray[np.int32] | None) -> Rows:
        found, intact = self._decode(group, rows)
        if not intact.all():
            raise PartDamagedError(f"{self._path}: {int((~intact).sum())} rows are not what was written")
        return found

    def _decode(self, group: int, rows: npt.NDArray[np.int32] | None) -> tuple[Rows, BoolArray]:
        """Read rows of a group, all for None, and say which are intact."""
        layout = self._layout
        with _damage(self._path):
            table = self._file.read_row_group(group, use_threads=False)
            if rows is not None:
                table = table.take(_plain(rows))
            n = table.num_rows
            theta = np.empty((n, len(layout.parameter_names)))
            for j, name in enumerate(layout.parameter_columns):
                theta[:, j] = _numbers(table[name])
            y = np.empty((n, len(layout.time), len(layout.output_names)))
            for k, name in enumerate(layout.output_names):
                y[:, :, k] = np.from_dlpack(table[name].combine_chunks().flatten()).reshape(y.shape[:2])
            found = layout.trajectories(theta, y, table[FAILURE].to_pylist())
            whole = Rows(found, _moments(table[WRITTEN]))
            return whole, whole.checks(layout.model_digest) == _numbers(table[CHECK])

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def _moments(column: Any) -> IntArray:
    return np.array(_numbers(column.cast(pa.int64())))


def _numbers(column: Any) -> npt.NDArray[Any]:
    """Return a column's values; pyarrow's own way to NumPy imports pandas, which takes half a second."""
    values: npt.NDArray[Any] = np.from_dlpack(column.combine_chunks())
    return values


def _plain(values: npt.NDArray[Any]) -> Any:
    """Return values as pyarrow has them; its own way imports pandas, too."""
    values = np.ascontiguousarray(values)
    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, values.size, [None, pa.py_buffer(values)])


def _texts(texts: Iterable[str]) -> Any:
    """Return texts as pyarrow has them."""
    encoded = [text.encode() for text in texts]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    buffers = [None, pa.py_buffer(ends), pa.py_buffer(b"".join(encoded))]
    return pa.Array.from_buffers(pa.string(), len(encoded), buffers)


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Turn what pyarrow says of a damaged file into one kind of error; the machine's troubles stay."""
    try:
        yield
    except PartDamagedError:
        raise
    except OSError as error:
        # Arrow's own complaints carry no number; an unreadable sector is damage as well.
        if error.errno not in (None, errno.EIO):
            raise
        raise PartDamagedError(f"{path}: {_one_line(error)}") from error
    except (pa.ArrowException, ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
        raise PartDamagedError(f"{path}: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
