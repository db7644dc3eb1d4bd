"""The doctor of the stores: everything is looked at, and what is safe is put right.

Not to be confused with the doctor of a case, who is behind `studies check`.
"""

from collections.abc import Callable, Sequence

from studies.console import Console
from studies.keeping.check_champions import check_champions
from studies.keeping.check_mlflow import check_mlflow
from studies.keeping.check_optuna import check_optuna
from studies.keeping.check_places import check_places
from studies.keeping.check_records import check_records, check_results
from studies.keeping.check_simulations import check_simulations
from studies.keeping.finding import StoreFinding
from studies.keeping.stores import read_stores
from studies.keeping.versions import Version, check_versions, is_readable, versions_of
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords

MAX_ROUNDS = 3
"""A repair may bring something to light that another one puts right."""


def examine(paths: ProjectPaths, console: Console) -> list[StoreFinding]:
    """Look at all stores; changes nothing.

    Args:
        paths: the project.
        console: shows how far it is.

    Raises:
        InputError: the storage cannot be reached.
    """
    versions = versions_of(paths)
    found = list(check_versions(paths, versions))
    with console.progress("reading records", 1) as advance:
        stores = read_stores(paths, advance)
    found += check_records(stores)
    found += check_champions(stores)
    found += check_results(stores)
    if _is_readable(versions, "Optuna"):
        found += check_optuna(stores)
    if _is_readable(versions, "MLflow"):
        found += check_mlflow(stores)
    with console.progress("reading simulations", 1) as advance:
        found += check_simulations(paths, advance)
    found += check_places(paths)
    return found


def repair(
    paths: ProjectPaths, console: Console, found: Sequence[StoreFinding]
) -> tuple[list[str], list[StoreFinding]]:
    """Put right what can be put right safely: no record is ever deleted.

    Args:
        paths: the project.
        console: tells what is done.
        found: what an examination has found.

    Returns:
        What was done, a line each, and what another examination finds now.
    """
    done: list[str] = []
    tried: set[tuple[str, str, str]] = set()
    for _ in range(MAX_ROUNDS):
        safe = [(one, one.repair) for one in found if one.level == "bad" and one.repair]
        new = [(one, work) for one, work in safe if (one.store, one.where, one.found) not in tried]
        if not new:
            break
        for finding, work in new:
            tried.add((finding.store, finding.where, finding.found))
            line = _attempt(finding, work)
            console.say(f"repair: {line}")
            done.append(line)
        found = examine(paths, console)
    return done, list(found)


def _attempt(finding: StoreFinding, work: Callable[[], str]) -> str:
    """Do a repair; one that fails leaves the others."""
    try:
        return work()
    except Exception as error:
        said = hide_passwords(str(error).splitlines()[0] if str(error) else "")
        return f"{finding.where}: could not be put right ({type(error).__name__}: {said})"


def _is_readable(versions: Sequence[Version], store: str) -> bool:
    return all(is_readable(version) for version in versions if version.store == store)
