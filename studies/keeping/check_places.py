"""The places themselves: space on the disk, locks, and what killed processes left."""

import shutil
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from studies.keeping.finding import StoreFinding, listed, ok
from studies.keeping.scratch import Scratch, leftovers
from studies.keeping.wording import readable
from studies.paths import ProjectPaths
from studies.report.wording import count
from studies.tuning.study_store import JOURNAL

LEAST_FREE = 2**30
"""Less free space than this is said. [byte]"""
OLD_LOCK_S = 60.0
"""Optuna's own backends take a lock over after half of that."""


def check_places(paths: ProjectPaths) -> Iterator[StoreFinding]:
    """Look at disk, locks and leftovers."""
    yield from _space(paths)
    yield from _locks(paths)
    found = list(leftovers(paths))
    if found:
        size = readable(sum(one.size for one in found))
        yield StoreFinding(
            "scratch",
            "bad",
            listed([paths.show(one.path) for one in found]),
            f"{count(len(found), 'leftover')} of killed processes, {size}",
            "--repair removes it" if len(found) == 1 else "--repair removes them",
            partial(_remove, paths, found),
        )


def _space(paths: ProjectPaths) -> Iterator[StoreFinding]:
    free = shutil.disk_usage(paths.root).free
    if free < LEAST_FREE:
        remedy = "studies gc shows what may go"
        yield StoreFinding("disk", "bad", str(paths.root), f"{readable(free)} free", remedy)
    else:
        yield ok("disk", str(paths.root), f"{readable(free)} free")


def _locks(paths: ProjectPaths) -> Iterator[StoreFinding]:
    """Look for locks that outlive their owners; ours do not, those of Optuna's own backends do."""
    for name in (f"{JOURNAL}.lock", f"{JOURNAL}.lock.rename"):
        lock = paths.mlruns / name
        if lock.is_symlink():
            found = "a lock of another program on Optuna's journal, which blocks everybody"
            is_old = time.time() - lock.lstat().st_mtime > OLD_LOCK_S
            remedy = "--repair removes it" if is_old else "stop that program, or wait a minute"
            repair = partial(_unlock, paths, lock) if is_old else None
            yield StoreFinding("locks", "bad", paths.show(lock), found, remedy, repair)


def _unlock(paths: ProjectPaths, lock: Path) -> str:
    lock.unlink(missing_ok=True)
    return f"{paths.show(lock)} removed"


def _remove(paths: ProjectPaths, found: Sequence[Scratch]) -> str:
    for one in found:
        if one.path.is_dir():
            shutil.rmtree(one.path, ignore_errors=True)
        else:
            one.path.unlink(missing_ok=True)
    return f"{count(len(found), 'leftover')} removed, {readable(sum(one.size for one in found))}"
