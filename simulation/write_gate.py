"""The gate that a path passes before it is written: inside a project, no link leads out of it.

A project's folder may be a stranger's. A link in it, as `mlruns/ui.log` to a file of the user, would have
that file overwritten.
"""

import os
from contextlib import suppress
from pathlib import Path

from simulation.errors import InputError

FOLLOW_VARIABLE = "STUDIES_FOLLOW_LINKS"
"""Variable of the environment that has links followed where it is 1, as for `mlruns` on another disk."""
# What SQLite writes beside a database; it follows links there as well.
_BESIDE_DATABASE = ("", "-wal", "-shm", "-journal")
# The end of a journal that belongs to several databases: https://www.sqlite.org/fileformat.html#the_rollback_journal
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")
_projects: set[Path] = set()


def guard_project(root: Path) -> None:
    """Have links in a project's folder checked from now on; the folder itself may be reached through one."""
    _projects.add(_real(root))


def follows_links() -> bool:
    """Return whether the user allows that links lead out of a project."""
    return os.environ.get(FOLLOW_VARIABLE) == "1"


def is_in_project(path: Path) -> bool:
    """Return whether a file lies in a guarded project, all links followed."""
    real = _real(path)
    return any(real.is_relative_to(root) for root in _projects)


def check_written(path: Path) -> None:
    """Refuse a path in a guarded project that a link leads out of it; any other place is the user's choice.

    Args:
        path: A file or folder that is written or made next.

    Raises:
        InputError: If it leads out, and the user does not allow that.
    """
    # A path with ".." is named for the folder in which it seems to lie.
    named, real = Path(os.path.normpath(Path(path).absolute())), _real(path)
    for root in {_real(folder) for folder in named.parents} & _projects:
        if not real.is_relative_to(root) and not follows_links():
            way = [*reversed(named.parents), named]
            link = next((one for one in way if _leads_out(one, root)), named)
            raise InputError(
                f"{link}: this link leads out of the project, to {_real(link)}; nothing is written there: "
                f"remove it, or allow such links: {FOLLOW_VARIABLE}=1"
            )


def check_database(file: Path) -> None:
    """Refuse the path of an SQLite database as `check_written` does, with all that SQLite writes beside it.

    Raises:
        InputError: If one of them leads out, and the user does not allow that; or if its journal names
            another file, which SQLite would delete.
    """
    for ending in _BESIDE_DATABASE:
        check_written(file.with_name(file.name + ending))
    journal = file.with_name(f"{file.name}-journal")
    if not journal.is_file():
        return
    # Another process that writes may remove its journal at any moment.
    with suppress(FileNotFoundError), journal.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(-min(len(_SUPER_JOURNAL), size), os.SEEK_END)
        if stream.read() == _SUPER_JOURNAL:
            raise InputError(
                f"{journal}: names another file, which SQLite would delete; this program writes no such "
                "journal: do not use this database"
            )


def _leads_out(path: Path, root: Path) -> bool:
    """Return whether a path is a link inside a project that leads out of it."""
    is_inside = root in {_real(folder) for folder in path.parents}
    return is_inside and path.is_symlink() and not _real(path).is_relative_to(root)


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))
