"""Is the store of simulations sound: every part, every row, every set of rows."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from simulation.errors import InputError
from simulation.store.folder import read_layout
from simulation.store.parts import Part, PartDamagedError
from simulation.store.row_set import RowSet
from simulation.store.store import SimulationStore
from studies.keeping.finding import StoreFinding, listed, ok
from studies.keeping.stores import OnProgress
from studies.paths import ProjectPaths
from studies.report.wording import count

STORE = "simulations"


def check_simulations(
    paths: ProjectPaths, on_progress: OnProgress = lambda done, total: None
) -> Iterator[StoreFinding]:
    """Read every row of every store and check it; changes nothing.

    Args:
        paths: the project.
        on_progress: told of bytes read, and how many there are.
    """
    folders = sorted(paths.data.glob("*/generated/simulations/*/"))
    parts = {folder: sorted(folder.glob("part-*.parquet")) for folder in folders}
    total = sum(file.stat().st_size for files in parts.values() for file in files)
    done = n_rows = 0
    found = []
    for folder in folders:
        where = paths.show(folder)
        try:
            layout = read_layout(folder)
        except InputError as error:
            remedy = "remove the folder; its simulations are done again when needed"
            found.append(StoreFinding(STORE, "bad", where, str(error).partition(";")[0], remedy))
            continue
        damaged = []
        for file in parts[folder]:
            on_progress(done, total)
            try:
                size = file.stat().st_size
                part = Part(file, layout)
                try:
                    n_rows += sum(rows.n for rows in part.blocks())
                finally:
                    part.close()
            except FileNotFoundError:  # merged meanwhile
                continue
            except PartDamagedError:
                damaged.append(file.name)
            done += size
        if damaged:
            found.append(
                StoreFinding(
                    STORE,
                    "bad",
                    where,
                    f"{count(len(damaged), 'part')} damaged: {listed(damaged)}",
                    "--repair keeps the good rows and sets the parts aside; the others are simulated again",
                    partial(_sort_out, paths, folder),
                )
            )
        found += _spool(paths, folder)
    found += _sets(paths)
    yield from found
    if n_rows and not any(finding.level == "bad" for finding in found):
        yield ok(
            STORE,
            "data/*/generated",
            f"{count(n_rows, 'row')} in {count(len(folders), 'folder')}, all as written",
        )


def _spool(paths: ProjectPaths, folder: Path) -> Iterator[StoreFinding]:
    orphans = [file for file in (folder / ".spool").glob("*") if file.is_file() and _is_orphan(file)]
    if orphans:
        yield StoreFinding(
            STORE,
            "bad",
            paths.show(folder),
            f"{count(len(orphans), 'arena')} of killed processes, perhaps with finished rows",
            "--repair stores their rows; the next simulation would, too",
            partial(_sort_out, paths, folder),
        )


def _is_orphan(file: Path) -> bool:
    """Return whether nobody owns an arena: its owner's lock died with it."""
    import os

    from simulation.workers.arena_file import owned

    descriptor = os.open(file, os.O_RDWR)
    try:
        return owned(descriptor)
    except OSError:
        return False
    finally:
        os.close(descriptor)


def _sets(paths: ProjectPaths) -> Iterator[StoreFinding]:
    for file in sorted(paths.data.glob("*/generated/sets/*.npz")):
        where = paths.show(file)
        try:
            rows = RowSet.load(file)
        except InputError as error:
            said = str(error).partition(": ")[2].partition(";")[0]
            remedy = "remove it; studies simulate writes it again without simulating"
            yield StoreFinding(STORE, "bad", where, said, remedy)
            continue
        if not rows.store.is_dir():
            yield StoreFinding(STORE, "note", where, "its rows are not here; they are simulated when needed")


def _sort_out(paths: ProjectPaths, folder: Path) -> str:
    """Read everything as a study would: what is damaged is set aside, what was finished is stored."""
    lines: list[str] = []
    with SimulationStore.at(folder, on_warning=lines.append) as store:
        n_lost_sight = 0
        for _ in range(len(list(folder.glob("part-*"))) + 1):
            try:
                for _block in store.stream():
                    pass
                break
            except LookupError:  # rows of a damaged part, gone now
                n_lost_sight += 1
        n_rows, n_recovered = len(store.theta), store.n_recovered
    said = f"{n_recovered} recovered, " if n_recovered else ""
    aside = f", {count(len(lines), 'part')} set aside" if lines else ""
    return f"{paths.show(folder)}: {said}{count(n_rows, 'row')} there{aside}"
