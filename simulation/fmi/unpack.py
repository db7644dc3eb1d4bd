"""What running an FMU needs, unpacked for the process that runs it."""

import stat
import zipfile
from pathlib import Path, PurePosixPath

from simulation.errors import InputError, MachineError
from simulation.fmi.fmpy_description import PLATFORM_FOLDERS
from simulation.foreign_file import archive_errors
from simulation.scratch import ScratchFolder

SCRATCH_PREFIX = "simulation-fmus-"


def unpacked(path: Path) -> ScratchFolder:
    """Unpack the part of an FMU that running it needs into a folder of its own.

    A folder for each process and no shared one: some FMUs write beside their resources, and a library that
    is loaded twice from one file shares its variables.

    Args:
        path: The FMU.

    Returns:
        The folder, to be removed by the caller.

    Raises:
        InputError: If a member of the archive is damaged, a link, or would land outside the folder.
        MachineError: If the disk is full.
    """
    scratch = ScratchFolder(SCRATCH_PREFIX)
    try:
        with archive_errors(path):
            _unpack(path, scratch.folder)
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


def _unpack(path: Path, folder: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename
            # Some tools write Windows' separators.
            parts = PurePosixPath(name.replace("\\", "/")).parts
            if ".." in parts or name.startswith(("/", "\\")) or (parts and ":" in parts[0]):
                raise InputError(
                    f"{path}: holds the member {name!r}, which points outside; do not trust this FMU"
                )
            needed = parts[:1] in {("modelDescription.xml",), ("resources",)}
            if not needed and (parts[:1] != ("binaries",) or parts[1:2] not in _PLATFORMS):
                continue
            # A zip archive has the Unix mode in the upper half.
            mode = member.external_attr >> 16
            if stat.S_ISLNK(mode):
                raise InputError(
                    f"{path}: holds the member {name!r}, which is a link; pack the file itself into the FMU"
                )
            target = Path(archive.extract(member, folder))
            # zipfile forgets that a resource is a program.
            if mode & stat.S_IXUSR and target.is_file():
                target.chmod(0o700)
    # The FMU gets the address of this folder, present or not.
    (folder / "resources").mkdir(exist_ok=True)


_PLATFORMS = {(name,) for name in PLATFORM_FOLDERS.values()}
