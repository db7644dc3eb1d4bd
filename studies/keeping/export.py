"""Gather studies with all that belongs to them, and pack them."""

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.store.folder import read_layout
from simulation.store.row_set import RowSet
from simulation.store.store import SimulationStore
from studies.console import Console
from studies.keeping.archive import pack
from studies.keeping.finding import listed
from studies.keeping.stores import KeptStudy, read_study
from studies.paths import ProjectPaths
from studies.stages.pipeline import read_json
from studies.tuning.champion import CHAMPION_FILE
from studies.tuning.trial_store import list_studies
from studies.tuning.trial_store_files import FileTrials

NOT_PACKED = ("report.json",)
"""Stages whose files are drawn again where they are wanted."""


@dataclass(frozen=True)
class Exported:
    """What an archive holds.

    Args:
        file: the archive.
        size: its size. [byte]
        studies: names of its studies.
        n_trials: trials in it, failed ones included.
        champions: names of the champions in it.
        stages: names of the stages whose results are in it.
        n_rows: simulations in it.
    """

    file: Path
    size: int
    studies: tuple[str, ...]
    n_trials: int
    champions: tuple[str, ...]
    stages: tuple[str, ...]
    n_rows: int

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {**vars(self), "file": str(self.file)}


def export(
    paths: ProjectPaths, which: Sequence[str], file: Path, console: Console, *, with_simulations: bool
) -> Exported:
    """Write an archive.

    Args:
        paths: the project.
        which: labels, studies or patterns of them.
        file: the archive.
        console: shows how far it is.
        with_simulations: whether the simulated rows go with them.

    Raises:
        InputError: nothing is called so, a record is damaged, or the file exists.
    """
    if file.exists():
        raise InputError(f"{file} exists; remove it or name another file")
    if not file.parent.is_dir():
        raise InputError(f"there is no folder {file.parent}; make it or name another file")
    studies, labels = _chosen(paths, which)
    with tempfile.TemporaryDirectory(dir=file.parent, prefix=".export-", suffix="-new") as scratch:
        target = ProjectPaths(Path(scratch))
        n_trials, n_all = 0, sum(len(study.records) for study in studies)
        with console.progress("trials", max(1, n_all)) as advance:
            for study in studies:
                for _ in _copy_trials(study, target):
                    n_trials += 1
                    advance(n_trials, n_all)
        names = {study.name for study in studies}
        champions = [name for study in studies for name in _copy_champion(paths, target, study, names)]
        stages = [stage for label in labels for stage in _copy_results(paths, target, label)]
        sets = _copy_sets(paths, target, studies, labels)
        n_rows = 0
        if with_simulations:
            with console.progress("simulations", max(1, len(sets))) as advance:
                for done, one in enumerate(sets):
                    n_rows += _copy_rows(paths, target, one)
                    advance(done + 1, len(sets))
        said = {
            "studies": {study.name: len(study.records) for study in studies},
            "labels": labels,
            "simulations": n_rows,
        }
        with console.progress("packing", 1) as advance:
            size = pack(target.root, file, said, advance)
    return Exported(file, size, tuple(sorted(names)), n_trials, tuple(champions), tuple(stages), n_rows)


def _chosen(paths: ProjectPaths, which: Sequence[str]) -> tuple[list[KeptStudy], list[str]]:
    """Return the studies that are meant, and the labels whose results go with them."""
    entries = list_studies(paths)
    with_results = {folder.name for folder in (paths.mlruns / "results").glob("*/")}
    names: dict[str, KeptStudy] = {}
    labels: set[str] = set()
    for word in which:
        found = [
            entry
            for entry in entries
            if any(
                fnmatchcase(name, word) for name in (entry.label, entry.name, entry.name.rpartition("/")[0])
            )
        ]
        bare = {label for label in with_results if fnmatchcase(label, word)}
        if not found and not bare:
            known = sorted({entry.name for entry in entries} | with_results)
            raise InputError(
                f"nothing is called {word!r}; there are {listed(known)}"
                if known
                else f"nothing is called {word!r}: this project has no studies yet; type: studies run"
            )
        labels |= {entry.label for entry in found} | bare
        names |= {entry.name: read_study(paths, entry) for entry in found}
    for study in names.values():
        if study.damaged:
            raise InputError(f"{study.name} has a damaged trial; type first: studies doctor --repair")
    return [names[name] for name in sorted(names)], sorted(labels)


def _copy_trials(study: KeptStudy, target: ProjectPaths) -> Iterator[int]:
    trials = FileTrials(target.mlruns, study.name)
    trials.describe(study.entry)
    for record in study.records:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "surrogate"
            folder.mkdir()
            has_weights = study.store.fetch_surrogate(record.index, folder)
            trials.write(record, study.store.history(record.index), folder if has_weights else None)
        yield record.index
    # What was claimed belongs to this place; what is planned goes on elsewhere.
    trials.describe(replace(study.entry, n_planned=max(study.entry.n_planned, len(study.records))))


def _copy_champion(
    paths: ProjectPaths, target: ProjectPaths, study: KeptStudy, names: set[str]
) -> Iterator[str]:
    entry = study.entry
    source = paths.champion(entry.label, entry.n_train)
    told = read_json(source / CHAMPION_FILE)
    place = target.champion(entry.label, entry.n_train)
    if told is not None and told.get("study") in names and not place.exists():
        shutil.copytree(source, place)
        yield f"{entry.label}/{place.name}"


def _copy_results(paths: ProjectPaths, target: ProjectPaths, label: str) -> Iterator[str]:
    for file in sorted(paths.results(label).glob("*")):
        if file.is_file() and not file.name.startswith(".") and file.name not in NOT_PACKED:
            target.results(label).mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, target.results(label) / file.name)
            # Beside the stages' manifests lie the numbers of calibrations and uncertainties.
            if file.suffix == ".json" and (read_json(file) or {}).get("stage") == file.stem:
                yield f"{label}/{file.stem}"


def _copy_sets(
    paths: ProjectPaths, target: ProjectPaths, studies: Sequence[KeptStudy], labels: Sequence[str]
) -> list[Path]:
    """Copy the sets of rows that the studies and stages name; return their places."""
    places = {how["file"] for study in studies for how in study.entry.recipe.get("datasets", {}).values()}
    for label in labels:
        manifest = read_json(paths.results(label) / "simulate.json") or {}
        places |= set(manifest.get("summary", {}).get("files", {}).values())
    found = []
    for place in sorted(places):
        source = paths.root / place
        if source.is_file() and source.resolve().is_relative_to(paths.data.resolve()):
            (target.root / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target.root / place)
            found.append(source)
    return found


def _copy_rows(paths: ProjectPaths, target: ProjectPaths, file: Path) -> int:
    """Copy the stored rows of a set; return how many were new in the copy."""
    rows = RowSet.load(file)
    if not rows.store.is_dir():
        return 0
    layout = read_layout(rows.store)
    place = target.root / rows.store.resolve().relative_to(paths.root.resolve())
    n_new = 0
    with (
        SimulationStore.at(rows.store) as source,
        SimulationStore(
            place,
            model_digest=layout.model_digest,
            parameter_names=layout.parameter_names,
            output_names=layout.output_names,
            time=layout.time,
        ) as copy,
    ):
        known = rows.theta[source.find(rows.theta) & ~copy.find(rows.theta)]
        for block in source.stream(known):
            copy.append(block)
            n_new += block.n
    return n_new
