"""Files of others: refused by their kind and their size before they are read; all limits stand here.

Whatever reads such a file gets its bytes, text, table or archive from here, and need not look again.
"""

import errno
import io
import lzma
import math
import os
import re
import stat
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.foreign_text import quoted, shortened

LIMITS_VARIABLE = "STUDIES_LIMITS"
"""Variable of the environment that multiplies all limits, 1 where it is not set."""
_MB = 1_000_000
# tomllib needs quadratic time for dotted keys; no real file nests tables so deeply.
_DEEPEST = 64
_DOTTED = re.compile(rf"(?<![\w-])(?:(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST},}}+")
# What zipfile raises on a member that is damaged, cut off, encrypted or of unknown compression, or lies.
_DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, RuntimeError, ValueError)
# Names of members that are too long, or at once a file and a folder, also come as errors of the system.
_OF_ARCHIVE = {
    None,  # bytes that are no bzip2
    errno.EINVAL,
    errno.ENAMETOOLONG,
    errno.EEXIST,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ENOTEMPTY,
}
# By the letter that `ls -l` writes for it.
_KINDS = {"d": "a folder", "p": "a pipe", "s": "a socket", "c": "a device", "b": "a device"}


@dataclass(frozen=True)
class Limit:
    """How large something may be.

    Attributes:
        what: What it limits, with its article.
        most: The limit where the user does not raise it.
        unit: What it counts.
    """

    what: str
    most: int
    unit: str = "MB"

    def check(self, amount: float, where: str) -> None:
        """Refuse what is larger.

        Args:
            amount: How large it is. [unit]
            where: The file, for the message.

        Raises:
            InputError: If it is too large; the line says how to raise the limit.
        """
        most = self.most * _factor()
        if amount > most:
            # A file that grows, or that has no size, is read as far as the limit alone.
            has = f"{quoted_amount(amount)} {self.unit}" if math.isfinite(amount) else f"more {self.unit}"
            needed = math.ceil(amount / self.most) if math.isfinite(amount) else math.ceil(2 * _factor())
            raise InputError(
                f"{where}: {self.what} may have {quoted_amount(most)} {self.unit} and this one has {has}; "
                f"if it is right, raise all limits: {LIMITS_VARIABLE}={needed}"
            )


CASE = Limit("a case file", 1)
PROFILE = Limit("a profile", 1)
RECORDING = Limit("a recording", 64)
RECORD = Limit("a record", 256)
FMU = Limit("an FMU", 500)
UNPACKED = Limit("what is unpacked of an archive", 2000)
DESCRIPTION = Limit("a modelDescription.xml", 64)
MEMBERS = Limit("an archive", 100_000, "files")
EVENT_INDICATORS = Limit("an FMU", 1_000_000, "event indicators")


def quoted_amount(amount: float) -> str:
    """Write an amount for people: 1.5, 3,000."""
    return f"{math.ceil(amount):,}" if amount >= 10 else f"{amount:.2g}"


def identity(path: Path) -> tuple[object, ...]:
    """Return what changes with a file, as far as that shows without reading it."""
    file = path.stat()
    return path, file.st_dev, file.st_ino, file.st_size, file.st_mtime_ns


def read_limited(path: Path, limit: Limit, *, if_missing: str = "correct the path") -> bytes:
    """Read a regular file that is not too large; what it is, is looked at before it is opened.

    Args:
        path: The file.
        limit: The most it may have. [MB]
        if_missing: What to do where there is no such file.

    Raises:
        InputError: If it is missing, no regular file, too large or cannot be read.
    """
    try:
        # Opening a pipe waits for a writer, and opening a device may do anything.
        _check_kind(path, path.stat(), limit)
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _check_kind(path, os.fstat(file.fileno()), limit)
            most = int(limit.most * _factor() * _MB)
            content = file.read(most + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {if_missing}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give {limit.what}") from None
    if len(content) > most:
        limit.check(math.inf, str(path))
    return content


def read_text(path: Path, limit: Limit, *, if_missing: str = "correct the path") -> str:
    """Read a text file as UTF-8; the same refusals as `read_limited`, and one of other encodings."""
    content = read_limited(path, limit, if_missing=if_missing)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if zipfile.is_zipfile(io.BytesIO(content)):
            raise InputError(
                f"{path}: is not {limit.what} but, it seems, an FMU; studies new makes a case of one"
            ) from None
        raise InputError(f"{path}: is not UTF-8 ({error.reason}); save it as UTF-8 text") from None


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Read the text of a TOML file.

    Raises:
        InputError: If it is no TOML, is nested too deeply, or has a number that is too long.
    """
    if _DOTTED.search(text):
        # Each part of a key is a table in a table, and takes tomllib as long as all before it.
        raise InputError(f"{where}: a name has more than {_DEEPEST} parts between dots; correct it")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"{where}: not valid TOML: {shortened(str(error))}; {_line_remedy(text, str(error))}"
        ) from None
    except RecursionError:
        raise InputError(f"{where}: its tables or lists stand in each other too deeply; correct it") from None
    except ValueError:
        # tomllib leaves this one to Python.
        raise InputError(f"{where}: a number has thousands of digits; correct it") from None


def _line_remedy(text: str, fault: str) -> str:
    """Return the remedy for a line that is no TOML: often a key needs quotes."""
    place = re.search(r"at line (\d+)", fault)
    line = text.splitlines()[int(place[1]) - 1] if place else ""
    key = re.match(r"\s*([^\s=\"'#\[{][^=\"'#]*?)\s*=", line)
    if key and not re.fullmatch(r"[\w.-]+", key[1], re.ASCII):
        return f'a name with more than letters and digits needs quotes; write "{shortened(key[1])}" = ...'
    return "correct that line"


def check_members(members: Sequence[zipfile.ZipInfo], where: str) -> None:
    """Refuse an archive that would be too much unpacked; no member is ever longer than it says.

    Args:
        members: What the archive says of each.
        where: The archive, for the message.

    Raises:
        InputError: If there are too many, or they are too large together.
    """
    MEMBERS.check(len(members), where)
    UNPACKED.check(sum(member.file_size for member in members) / _MB, where)


@contextmanager
def archive_errors(path: Path) -> Iterator[None]:
    """Turn what reading or unpacking an archive raises into one line, where the archive is at fault.

    Args:
        path: The archive, for the message.

    Raises:
        InputError: If a member is damaged, or is not what the archive says.
        OSError: If the machine is in the way.
    """
    try:
        yield
    except (InputError, *_DAMAGED, OSError) as error:
        if isinstance(error, InputError) or (isinstance(error, OSError) and error.errno not in _OF_ARCHIVE):
            raise
        said = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{path}: cannot be unpacked ({shortened(said)}); export it again") from None


def _check_kind(path: Path, found: os.stat_result, limit: Limit) -> None:
    if not stat.S_ISREG(found.st_mode):
        what = _KINDS.get(stat.filemode(found.st_mode)[0], "no regular file")
        raise InputError(f"{path}: is {what}; give {limit.what} as a regular file")
    limit.check(found.st_size / _MB, str(path))


def _factor() -> float:
    said = os.environ.get(LIMITS_VARIABLE) or "1"
    try:
        factor = float(said)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < 1e6:
        raise InputError(f"${LIMITS_VARIABLE} is {quoted(said)}; write a number such as 4, or unset it")
    return factor
