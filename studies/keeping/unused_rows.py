"""Simulations that no set of rows refers to; they are expensive and go only when asked for."""

from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from simulation.arrays import BoolArray
from simulation.errors import InputError
from simulation.store.folder import StoreFolder, read_layout, users
from simulation.store.index import Keys, row_keys
from simulation.store.parts import Part, PartDamagedError, write_part
from simulation.store.row_set import RowSet
from simulation.store.rows import Layout
from studies.keeping.leftover import Leftover
from studies.paths import ProjectPaths

KIND = "simulations"


def unused_rows(paths: ProjectPaths, gone: Collection[Path]) -> Iterator[Leftover]:
    """Find the rows of every store that no set refers to.

    Args:
        paths: the project.
        gone: sets that are about to be removed.
    """
    wanted = _wanted(file for file in _sets(paths) if file not in gone)
    for folder in sorted(paths.data.glob("*/generated/simulations/*/")):
        try:
            layout = read_layout(folder)
        except InputError:
            continue
        keys = wanted.get(folder.resolve())
        n_rows = n_free = size = 0
        changed_s = 0.0
        for file in sorted(folder.glob("part-*.parquet")):
            try:
                free = _free(file, layout, keys)
            except (PartDamagedError, FileNotFoundError):
                continue
            n_rows, n_free = n_rows + len(free), n_free + int(free.sum())
            size += round(file.stat().st_size * free.mean()) if len(free) else 0
            changed_s = max(changed_s, file.stat().st_mtime)
        if n_free:
            yield Leftover(
                KIND,
                f"{paths.show(folder)}: {n_free} of {n_rows} rows",
                "no set of rows names them; calibrations and indices may ask for them again",
                size,
                changed_s,
                partial(_drop, paths, folder, layout),
            )


def _sets(paths: ProjectPaths) -> Iterator[Path]:
    return paths.data.glob("*/generated/sets/*.npz")


def _wanted(sets: Iterable[Path]) -> dict[Path, Keys]:
    """Return the rows that sets refer to, by the folder of their store."""
    found: dict[Path, list[Keys]] = {}
    for file in sets:
        try:
            rows = RowSet.load(file)
        except InputError:
            continue
        found.setdefault(rows.store.resolve(), []).append(row_keys(rows.theta))
    return {folder: np.unique(np.concatenate(keys)) for folder, keys in found.items()}


def _free(file: Path, layout: Layout, keys: Keys | None) -> BoolArray:
    """Say which rows of a part nobody refers to. Shape (n,)."""
    part = Part(file, layout)
    try:
        theta, _, _ = part.keys()
    finally:
        part.close()
    if keys is None:
        return np.ones(len(theta), dtype=np.bool_)
    return ~np.isin(row_keys(theta), keys)


def _drop(paths: ProjectPaths, folder: Path, layout: Layout) -> str:
    """Write every part again without the rows that nobody refers to, unless a command works with them.

    Sets that have come since are left their rows, though no stage may name them yet.
    """
    alone = users(folder, shared=False)
    if not alone.try_acquire():
        return "a command works with them now"
    try:
        files = StoreFolder(folder, layout)
        with files.merging():
            keys = _wanted(_sets(paths)).get(folder.resolve())
            for name in files.sizes():
                with suppress(PartDamagedError, FileNotFoundError):
                    _drop_from(files, name, layout, keys)
    finally:
        alone.release()
    return ""


def _drop_from(files: StoreFolder, name: str, layout: Layout, keys: Keys | None) -> None:
    free = _free(files.path / name, layout, keys)
    if not free.any():
        return
    part = Part(files.path / name, layout)
    try:
        whole = list(part.blocks())
    finally:
        part.close()
    start, kept = 0, []
    for rows in whole:
        kept.append(rows.take(~free[start : start + rows.n]))
        start += rows.n
    if not free.all():
        files.publish(lambda file: write_part(file, layout, kept))
    files.remove([name])
