"""Simulations that no set of rows refers to; they are expensive and go only when asked for."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from simulation.arrays import BoolArray
from simulation.errors import InputError
from simulation.store.folder import StoreFolder, read_layout
from simulation.store.index import Keys, row_keys
from simulation.store.parts import Part, PartDamagedError, write_part
from simulation.store.row_set import RowSet
from simulation.store.rows import Layout
from studies.keeping.leftover import Leftover
from studies.keeping.stores import Stores
from studies.keeping.unused_files import used_sets

KIND = "simulations"


def unused_rows(stores: Stores) -> Iterator[Leftover]:
    """Find the rows of every store that no set refers to."""
    paths = stores.paths
    wanted: dict[Path, list[Keys]] = {}
    for place in used_sets(stores):
        try:
            rows = RowSet.load(paths.root / place)
        except InputError:
            continue
        wanted.setdefault(rows.store.resolve(), []).append(row_keys(rows.theta))
    for folder in sorted(paths.data.glob("*/generated/simulations/*/")):
        try:
            layout = read_layout(folder)
        except InputError:
            continue
        kept = wanted.get(folder.resolve(), [])
        keys = np.unique(np.concatenate(kept)) if kept else None
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
                partial(_drop, folder, layout, keys),
            )


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


def _drop(folder: Path, layout: Layout, keys: Keys | None) -> str:
    """Write every part again without the rows that nobody refers to."""
    files = StoreFolder(folder, layout)
    lock = files.merging()
    if not lock.try_acquire():
        return "somebody merges its parts now"
    try:
        for name in files.sizes():
            try:
                free = _free(folder / name, layout, keys)
                if not free.any():
                    continue
                part = Part(folder / name, layout)
                try:
                    whole = list(part.blocks())
                finally:
                    part.close()
            except (PartDamagedError, FileNotFoundError):
                continue
            start, kept = 0, []
            for rows in whole:
                kept.append(rows.take(~free[start : start + rows.n]))
                start += rows.n
            if not free.all():
                files.publish(lambda file, kept=kept: write_part(file, layout, kept))  # type: ignore[misc]
            files.remove([name])
    finally:
        lock.release()
    return ""
