"""Take over the studies of an archive: look first, write what is new, and show it in Optuna and MLflow."""

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.store.folder import MANIFEST as STORE_MANIFEST
from simulation.store.folder import read_layout
from simulation.store.store import SimulationStore
from studies.console import Console
from studies.keeping.archive import unpack
from studies.keeping.finding import listed
from studies.keeping.optuna_view import rebuild_optuna
from studies.keeping.stage_views import write_stages
from studies.keeping.stores import DAMAGE, KeptStudy, read_stores, read_study
from studies.keeping.views import write_to_mlflow
from studies.paths import ProjectPaths
from studies.recipe import file_digest
from studies.stages.pipeline import read_json
from studies.tuning.champion import CHAMPION_FILE, champion_lock, read_champion
from studies.tuning.trial_record import TrialRecord, best_record, replace_folder, trial_name
from studies.tuning.trial_store import open_trials

_RESULT = ("state", "params", "config", "seed", "metrics", "reports", "n_epochs", "best_epoch", "digests")
"""What two records of one trial must agree in."""


@dataclass
class Imported:
    """What was taken over.

    Args:
        new: trials that were not here, by study.
        known: trials that were here already, by study.
        champions: champions that are here now.
        stages: stages whose results are here now.
        n_rows: simulations that were not here.
        notes: what a user should know.
    """

    new: dict[str, int] = field(default_factory=dict)
    known: dict[str, int] = field(default_factory=dict)
    champions: list[str] = field(default_factory=list)
    stages: list[str] = field(default_factory=list)
    n_rows: int = 0
    notes: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)


def import_archive(paths: ProjectPaths, file: Path, console: Console) -> Imported:
    """Take over an archive; importing it again changes nothing.

    Args:
        paths: the project.
        file: the archive.
        console: shows how far it is.

    Raises:
        InputError: the archive cannot be used, or a trial here says something else; nothing is changed then.
    """
    if not file.is_file():
        said = f"{file} is a folder" if file.is_dir() else f"there is no file {file}"
        raise InputError(f"{said}; give an archive that studies export has written")
    paths.mlruns.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=paths.mlruns, prefix=".import-", suffix="-new") as scratch:
        with console.progress("unpacking", 1) as advance:
            unpack(file, Path(scratch), advance)
        source = ProjectPaths(Path(scratch))
        try:
            studies = read_stores(source).studies
        except DAMAGE as error:
            raise InputError(f"{file} holds a study that cannot be read ({error}); export it again") from None
        _require_agreement(paths, studies, file)
        done = Imported()
        n_all, n_done = sum(len(study.records) for study in studies), 0
        with console.progress("trials", max(1, n_all)) as advance:
            for study in studies:
                for _ in _take_trials(paths, study, done):
                    n_done += 1
                    advance(n_done, n_all)
        _take_sets(source, paths)  # before their rows: what a set names, gc leaves alone
        with console.progress("simulations", 1) as advance:
            _take_rows(source, paths, done)
        _take_champions(source, paths, studies, done)
        labels = _take_results(source, paths, done)
        _show(paths, studies, labels, console, done)
    return done


def _require_agreement(paths: ProjectPaths, studies: Sequence[KeptStudy], file: Path) -> None:
    for study in studies:
        if study.damaged:
            index, reason = study.damaged[0]
            raise InputError(f"{file}: {study.name}/{trial_name(index)} cannot be read ({reason})")
        store = open_trials(paths, study.name)
        entry = store.entry()
        if entry is None:
            continue
        here = read_study(paths, entry)
        if here.is_busy:
            raise InputError(f"{study.name} is being tuned here at the moment; wait for it or stop it")
        ours = {record.index: record for record in here.records}
        for record in study.records:
            different = _different(record, ours.get(record.index))
            if different:
                raise InputError(
                    f"{record.key} is here with other results than in {file} ({listed(different)}); nothing "
                    "was imported: import it into another project, or remove that study here (studies gc)"
                )


def _different(theirs: TrialRecord, ours: TrialRecord | None) -> list[str]:
    if ours is None:
        return []
    return [name for name in _RESULT if repr(getattr(theirs, name)) != repr(getattr(ours, name))]


def _take_trials(paths: ProjectPaths, study: KeptStudy, done: Imported) -> Iterator[int]:
    store = open_trials(paths, study.name)
    present = store.entry()
    entry = study.entry
    if present is not None:
        entry = replace(present, n_planned=max(present.n_planned, entry.n_planned))
    store.describe(entry)
    ours = set(store.finished())
    # Weights are kept of the best trial only; where another one is better here, they would be in the way.
    best = best_record([*store.records(), *(one for one in study.records if one.index not in ours)])
    for record in study.records:
        done.known[study.name] = done.known.get(study.name, 0) + (record.index in ours)
        done.new[study.name] = done.new.get(study.name, 0) + (record.index not in ours)
        if record.index not in ours:
            with tempfile.TemporaryDirectory() as scratch:
                folder = Path(scratch) / "surrogate"
                folder.mkdir()
                is_best = best is not None and record.index == best.index
                has_weights = is_best and study.store.fetch_surrogate(record.index, folder)
                store.write(record, study.store.history(record.index), folder if has_weights else None)
        yield record.index
    store.keep_only_best()


def _take_rows(source: ProjectPaths, paths: ProjectPaths, done: Imported) -> None:
    for manifest in sorted(source.data.glob(f"*/generated/simulations/*/{STORE_MANIFEST}")):
        folder = manifest.parent
        layout = read_layout(folder)
        with (
            SimulationStore.at(folder) as theirs,
            SimulationStore(
                paths.root / folder.relative_to(source.root),
                model_digest=layout.model_digest,
                parameter_names=layout.parameter_names,
                output_names=layout.output_names,
                time=layout.time,
            ) as ours,
        ):
            theta = theirs.theta
            for block in theirs.stream(theta[~ours.find(theta)]):
                ours.append(block)
                done.n_rows += block.n


def _take_sets(source: ProjectPaths, paths: ProjectPaths) -> None:
    for file in sorted(source.data.glob("*/generated/sets/*.npz")):
        _copy_new(file, paths.root / file.relative_to(source.root))


def _take_champions(
    source: ProjectPaths, paths: ProjectPaths, studies: Sequence[KeptStudy], done: Imported
) -> None:
    names = {study.name for study in studies}
    for file in sorted((source.mlruns / "champions").glob(f"*/*/{CHAMPION_FILE}")):
        theirs = read_champion(file.parent)
        place = paths.root / file.parent.relative_to(source.root)
        where = f"{theirs.label}/{place.name}"
        if place.is_dir():
            try:
                ours = read_champion(place)
            except InputError as error:
                done.notes.append(f"the champion here was replaced: {error}")
            else:
                if (ours.study, ours.index) == (theirs.study, theirs.index):
                    continue
                same = ours.study == theirs.study and theirs.study in names
                best = best_record(open_trials(paths, theirs.study).records()) if same else None
                if best is None or best.index != theirs.index:
                    present = f"trial {ours.index} of {ours.study}"
                    done.notes.append(f"{where}: the champion here ({present}) stays")
                    continue
        scratch = place.with_name(f".{place.name}-new")
        with champion_lock(paths, theirs.label, theirs.n_train):
            shutil.rmtree(scratch, ignore_errors=True)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copytree(file.parent, scratch)
            replace_folder(scratch, place)
        done.champions.append(where)


def _take_results(source: ProjectPaths, paths: ProjectPaths, done: Imported) -> list[str]:
    """Copy the results of stages that are not finished here; return the labels."""
    labels = []
    for folder in sorted((source.mlruns / "results").glob("*/")):
        labels.append(folder.name)
        for file in sorted(folder.glob("*.json")):
            manifest = read_json(file) or {}
            if manifest.get("stage") != file.stem:
                continue
            place, name = paths.results(folder.name) / file.name, f"{folder.name}/{file.stem}"
            if place.is_file():
                if file_digest(place) != file_digest(file):
                    done.notes.append(f"{name}: finished here, yours stays")
                continue
            made = [source.root / one for one in manifest["files"]]
            # The manifest last: with it the stage is finished. Files elsewhere come with their studies.
            for one in [*(one for one in made if one.parent == folder and one.is_file()), file]:
                _copy_new(one, place.with_name(one.name), replaced=True)
            done.stages.append(name)
    return labels


def _show(
    paths: ProjectPaths, studies: Sequence[KeptStudy], labels: Sequence[str], console: Console, done: Imported
) -> None:
    """Bring Optuna's and MLflow's views up to date."""
    with console.progress("Optuna and MLflow", max(1, len(studies))) as advance:
        for number, study in enumerate(sorted(studies, key=lambda one: one.entry.created_s)):
            entry = open_trials(paths, study.name).entry()
            if entry is not None:
                here = read_study(paths, entry)
                rebuild_optuna(here)
                write_to_mlflow(here)
            advance(number + 1, len(studies))
        for label in labels:
            done.notes += write_stages(paths, label)


def _copy_new(file: Path, place: Path, *, replaced: bool = False) -> None:
    if replaced or not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        scratch = place.with_name(f".{place.name}-new")
        shutil.copy2(file, scratch)
        scratch.replace(place)
