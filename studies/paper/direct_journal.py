"""The journal of one long start: what the model answered, so that an interrupted start goes on for free."""

import zlib
from pathlib import Path
from types import TracebackType

import numpy as np

from simulation.arrays import FloatArray


class Journal:
    """The answers to a start's calls, kept on disk: an interrupted start is replayed without simulating.

    An optimizer with the same seed asks the same points in the same order; a checksum of each tells when not.
    """

    _ENTRY = np.dtype([("point", "<u4"), ("mse", "<f8")])
    _EVERY = 1000

    def __init__(self, file: Path) -> None:
        """Read what there is; a half-written end is left out."""
        self._file = file
        content = file.read_bytes() if file.is_file() else b""
        whole = len(content) // self._ENTRY.itemsize
        self._known = np.frombuffer(content[: whole * self._ENTRY.itemsize], self._ENTRY)
        self._asked = 0
        self._new: list[tuple[int, float]] = []

    def answer(self, theta: FloatArray) -> float | None:
        """Return the MSE that is known of the next call; None when it has to be simulated."""
        point = zlib.crc32(np.ascontiguousarray(theta).tobytes())
        at, self._asked = self._asked, self._asked + 1
        if at < len(self._known) and int(self._known["point"][at]) == point:
            return float(self._known["mse"][at])
        if at < len(self._known):  # another SciPy, another order: what follows is of no use
            self._known = self._known[:at].copy()
            self._rewrite()
        return None

    def note(self, theta: FloatArray, mse: float) -> None:
        """Keep the answer to the call just asked for."""
        self._new.append((zlib.crc32(np.ascontiguousarray(theta).tobytes()), mse))
        if len(self._new) >= self._EVERY:
            self.flush()

    def flush(self) -> None:
        """Write what is new."""
        if self._new:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            size = self._ENTRY.itemsize
            with self._file.open("ab") as stream:
                stream.truncate(stream.tell() // size * size)
                stream.write(np.array(self._new, self._ENTRY).tobytes())
            self._new = []

    def __enter__(self) -> "Journal":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.flush()

    def _rewrite(self) -> None:
        self._file.write_bytes(self._known.tobytes())
