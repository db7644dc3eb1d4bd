"""`studies gc`: what nothing refers to, how much it takes, and its end."""

import sys
from collections.abc import Iterator, Sequence

from simulation.errors import InputError
from studies.console import Block, Column, Console, Said, Table
from studies.keeping.finding import listed
from studies.keeping.leftover import Leftover, older
from studies.keeping.stores import read_stores
from studies.keeping.unused_files import SETS, unused_files
from studies.keeping.unused_rows import unused_rows
from studies.keeping.unused_runs import unused_runs
from studies.keeping.unused_studies import unused_studies, unused_weights
from studies.keeping.wording import readable
from studies.paths import ProjectPaths
from studies.report.wording import count


def find_unused(
    paths: ProjectPaths, console: Console, *, age_s: float, with_simulations: bool
) -> list[Leftover]:
    """Return what may go.

    Args:
        paths: the project.
        console: shows how far it is.
        age_s: only what has not changed for so long. [s]
        with_simulations: whether to look among the simulations, too.

    Raises:
        InputError: the storage cannot be reached.
    """
    with console.progress("reading records", 1) as advance:
        stores = read_stores(paths, advance)
    found = [*unused_studies(stores), *unused_weights(stores), *unused_runs(stores), *unused_files(stores)]
    found = older(found, age_s)
    if with_simulations:
        gone = {paths.root / one.name for one in found if one.kind == SETS}
        found += older(list(unused_rows(paths, gone)), age_s)
    return found


def blocks_of(found: Sequence[Leftover]) -> list[Block]:
    """Return what a person sees: a line per kind."""
    if not found:
        return [Said("Nothing to remove.")]
    rows = []
    for kind in dict.fromkeys(one.kind for one in found):
        ours = [one for one in found if one.kind == kind]
        reasons = list(dict.fromkeys(one.why for one in ours))
        names = listed([one.name for one in ours])
        rows.append([kind, len(ours), readable(sum(one.size for one in ours)), names, listed(reasons)])
    columns = [Column("kind"), Column("things", True), Column("size", True), Column("which"), Column("why")]
    total = readable(sum(one.size for one in found))
    return [Table("What nothing refers to", columns, rows), Said(f"{count(len(found), 'thing')}, {total}")]


def is_agreed(console: Console, found: Sequence[Leftover]) -> bool:
    """Ask whether all of it may go.

    Raises:
        InputError: nobody can answer.
    """
    if not sys.stdin.isatty() or console.as_json:
        raise InputError("nobody is here to be asked; give --yes to remove all of it, --dry-run to look only")
    sys.stderr.write(f"Remove {'it' if len(found) == 1 else f'all {len(found)}'} for good? [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def remove(console: Console, found: Sequence[Leftover]) -> Iterator[tuple[Leftover, str]]:
    """Remove one thing after the other; yields each with the reason why it stays, empty where it is gone."""
    with console.progress("removing", max(1, len(found))) as advance:
        for done, one in enumerate(found):
            try:
                why_not = one.remove()
            except FileNotFoundError:  # somebody else was faster
                why_not = ""
            except OSError as error:
                why_not = f"{error.strerror}: {error.filename}"
            yield one, why_not
            advance(done + 1, len(found))
