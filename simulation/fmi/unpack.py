"""What running an FMU needs, unpacked for the process that runs it."""

import stat
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from simulation.errors import InputError, MachineError
from simulation.foreign_file import archive_errors, identity
from simulation.scratch import ScratchFolder

SCRATCH_PREFIX = "simulation-fmus-"
MOST_KEPT_BYTES = 20_000_000
"""As much of an FMU that process after process unpacks is kept in memory; larger ones are read anew."""


@dataclass(frozen=True)
class Member:
    """A file that running an FMU needs.

    Attributes:
        place: Where it is unpacked to, relative to the folder; of a folder, its name.
        content: What it holds; None for a folder.
        is_program: Whether it may be run.
    """

    place: str
    content: bytes | None
    is_program: bool


# By the identity of the FMU's file and the binary that is run.
_kept: dict[tuple[object, ...], tuple[Member, ...]] = {}


def keep(path: Path, binary: str) -> None:
    """Keep what running an FMU needs in memory, so that forks of this process write it and read nothing.

    Args:
        path: The FMU.
        binary: The member that is run, which may need others of its folder.

    Raises:
        InputError: As `unpacked`.
    """
    with archive_errors(path), zipfile.ZipFile(path) as archive:
        needed = list(_needed(path, archive, binary))
        if sum(member.file_size for member, _ in needed) <= MOST_KEPT_BYTES:
            _kept[identity(path), binary] = tuple(
                Member(member.filename, None if member.is_dir() else archive.read(member), is_program)
                for member, is_program in needed
            )


def unpacked(path: Path, binary: str) -> ScratchFolder:
    """Unpack the part of an FMU that running it needs into a folder of its own.

    A folder for each process and no shared one: some FMUs write beside their resources, and a library that
    is loaded twice from one file shares its variables.

    Args:
        path: The FMU.
        binary: The member that is run, which may need others of its folder.

    Returns:
        The folder, to be removed by the caller.

    Raises:
        InputError: If a member of the archive is damaged, a link, or would land outside the folder.
        MachineError: If the disk is full.
    """
    scratch = ScratchFolder(SCRATCH_PREFIX)
    try:
        with archive_errors(path):
            if (members := _kept.get((identity(path), binary))) is None:
                _unpack(path, scratch.folder, binary)
            for member in members or ():
                _write(member, scratch.folder)
        # The FMU gets the address of this folder, present or not.
        (scratch.folder / "resources").mkdir(exist_ok=True)
    # A Ctrl-C, too, must leave no folder.
    except BaseException as error:
        scratch.remove()
        if isinstance(error, OSError):
            raise MachineError(
                f"{path}: cannot be unpacked to {scratch.folder.parent} ({error.strerror}); free some space "
                "or name another folder in the environment variable TMPDIR"
            ) from None
        raise
    return scratch


def _needed(path: Path, archive: zipfile.ZipFile, binary: str) -> Iterator[tuple[zipfile.ZipInfo, bool]]:
    """Return the members that running an FMU needs, and which are programs."""
    platform = PurePosixPath(binary).parts[:2]
    for member in archive.infolist():
        name = member.filename
        # Some tools write Windows' separators.
        parts = PurePosixPath(name.replace("\\", "/")).parts
        if ".." in parts or name.startswith(("/", "\\")) or (parts and ":" in parts[0]):
            raise InputError(
                f"{path}: holds the member {name!r}, which points outside; do not trust this FMU"
            )
        needed = parts[:1] in {("modelDescription.xml",), ("resources",)}
        if not needed and parts[:2] != platform:
            continue
        # A zip archive has the Unix mode in the upper half.
        mode = member.external_attr >> 16
        if stat.S_ISLNK(mode):
            raise InputError(
                f"{path}: holds the member {name!r}, which is a link; pack the file itself into the FMU"
            )
        yield member, bool(mode & stat.S_IXUSR)


def _unpack(path: Path, folder: Path, binary: str) -> None:
    with zipfile.ZipFile(path) as archive:
        for member, is_program in _needed(path, archive, binary):
            target = Path(archive.extract(member, folder))
            # zipfile forgets that a resource is a program.
            if is_program and target.is_file():
                target.chmod(0o700)


def _write(member: Member, folder: Path) -> None:
    target = folder / member.place
    if member.content is None:
        target.mkdir(parents=True, exist_ok=True)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(member.content)
    if member.is_program:
        target.chmod(0o700)
