"""One thing that nothing refers to any more, and how much space it takes."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studies.keeping.scratch import size_of


@dataclass(frozen=True)
class Leftover:
    """A thing that may go.

    Args:
        kind: what it is, for example "superseded studies".
        name: which one.
        why: why nothing needs it.
        size: what it takes. [byte]
        changed_s: its last change. [s since 1970, UTC]
        remove: removes it; returns why it did not, empty where it did.
    """

    kind: str
    name: str
    why: str
    size: int
    changed_s: float
    remove: Callable[[], str] = field(compare=False, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {"kind": self.kind, "name": self.name, "why": self.why, "size": self.size}


def older(found: Sequence[Leftover], age_s: float) -> list[Leftover]:
    """Return what has not changed for so long. [s]."""
    return [one for one in found if time.time() - one.changed_s >= age_s]


def newest_change(place: Path) -> float:
    """Return the last change of a file, or of anything in a folder. [s since 1970, UTC]."""
    found = place.stat().st_mtime
    if place.is_dir():
        found = max((file.lstat().st_mtime for file in place.rglob("*")), default=found)
    return found


def of_place(kind: str, place: Path, name: str, why: str) -> Leftover:
    """Return a file or folder as something that may go."""
    from studies.keeping.views import remove_folder

    def remove() -> str:
        if place.is_dir():
            remove_folder(place)
        else:
            place.unlink(missing_ok=True)
        return ""

    return Leftover(kind, name, why, size_of(place), newest_change(place), remove)
