"""Files that nothing refers to: sets of rows, reports, what was kept aside, what killed processes left."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from simulation.errors import InputError
from simulation.store.folder import users
from simulation.store.row_set import RowSet
from studies.keeping.check_records import SET_ASIDE
from studies.keeping.leftover import Leftover, of_place
from studies.keeping.scratch import Scratch, leftovers
from studies.keeping.stores import Stores
from studies.keeping.upgrade import COPIES
from studies.keeping.views import remove_folder
from studies.stages.pipeline import read_json

SETS = "sets of rows"


def unused_files(stores: Stores) -> Iterator[Leftover]:
    """Find files that may go."""
    paths = stores.paths
    used = used_sets(stores)
    for file in sorted(paths.data.glob("*/generated/sets/*.npz")):
        if paths.relative(file) not in used:
            unnamed = of_place(SETS, file, paths.show(file), "no stage and no study names it")
            yield replace(unnamed, remove=partial(_remove_set, stores, file))
    labels = {study.entry.label for study in stores.studies}
    labels |= {folder.name for folder in (paths.mlruns / "results").glob("*/")}
    for folder in sorted((paths.mlruns / "reports").glob("*/")):
        if folder.name not in labels:
            yield of_place("reports", folder, paths.show(folder), "nothing it reports on is here")
    for folder in sorted(paths.mlruns.rglob(SET_ASIDE)):
        yield of_place("damaged files", folder, paths.show(folder), "kept aside by studies doctor")
    for folder in sorted(paths.data.glob("*/generated/simulations/*/_damaged")):
        yield of_place("damaged files", folder, paths.show(folder), "set aside when they were read")
    for file in sorted((paths.mlruns / COPIES).glob("*")):
        if not file.name.startswith("."):
            yield of_place("copies of databases", file, paths.show(file), "kept before an upgrade")
    for file in sorted(paths.mlruns.glob("*.damaged*")):
        yield of_place("damaged files", file, paths.show(file), "kept aside by studies doctor")
    for one in leftovers(paths):
        yield Leftover(
            "scratch",
            paths.show(one.path),
            "its process is no more",
            one.size,
            one.changed_s,
            partial(_remove_scratch, one),
        )


def used_sets(stores: Stores) -> set[str]:
    """Return the places of the sets of rows that stages and studies name."""
    used = {
        str(how["file"])
        for study in stores.studies
        for how in study.entry.recipe.get("datasets", {}).values()
    }
    for file in (stores.paths.mlruns / "results").glob("*/simulate.json"):
        used |= set((read_json(file) or {}).get("summary", {}).get("files", {}).values())
    return used


def _remove_set(stores: Stores, file: Path) -> str:
    """Remove a set unless a command works with its simulations: it may be about to name it."""
    alone = None
    with suppress(InputError):
        store = RowSet.load(file).store
        alone = users(store, shared=False) if store.is_dir() else None
    if alone is not None and not alone.try_acquire():
        return "a command works with its simulations now"
    try:
        if stores.paths.relative(file) in used_sets(stores):
            return "a stage names it by now"
        file.unlink(missing_ok=True)
    finally:
        if alone is not None:
            alone.release()
    return ""


def _remove_scratch(one: Scratch) -> str:
    if one.path.is_dir():
        remove_folder(one.path)
    else:
        one.path.unlink(missing_ok=True)
    return ""
