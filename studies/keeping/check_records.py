"""Are the records sound, on which everything else is built: trials, champions, results."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from simulation.errors import InputError
from studies.keeping.finding import StoreFinding, listed, ok
from studies.keeping.stores import DAMAGE, KeptStudy, Stores
from studies.recipe import file_digest
from studies.report.wording import count
from studies.tuning.champion import CHAMPION_FILE, WEIGHTS_FILE, read_champion
from studies.tuning.trial_record import HISTORY_FILE, TrialRecord, trial_name

STORE = "records"
SET_ASIDE = ".damaged"
"""Folder beside trials or results in which damaged files are kept."""


def check_records(stores: Stores) -> Iterator[StoreFinding]:
    """Read every record, learning curve and best weights."""
    n_trials = sum(len(study.records) for study in stores.studies)
    found = [finding for study in stores.studies for finding in _study(study)]
    yield from found
    if not found:
        yield ok(
            STORE,
            "trials",
            f"{count(len(stores.studies), 'study', 'studies')}, {count(n_trials, 'trial')}, all readable",
        )


def _study(study: KeptStudy) -> Iterator[StoreFinding]:
    for index, reason in study.damaged:
        yield StoreFinding(
            STORE,
            "bad",
            f"{study.name}/{trial_name(index)}",
            f"its record cannot be read ({reason})",
            "--repair keeps it aside, studies tune trains the trial again",
            partial(_set_trial_aside, study, index),
        )
    for record in study.records:
        try:
            study.store.history(record.index)
        except (*DAMAGE, OSError) as error:
            yield StoreFinding(
                STORE,
                "bad",
                record.key,
                f"its learning curves cannot be read ({type(error).__name__})",
                "--repair writes what its record still tells of them",
                partial(_write_reports, study, record),
            )
    if study.dead_claims:
        names = listed([trial_name(claim.index) for claim in study.dead_claims])
        yield StoreFinding(
            STORE,
            "bad",
            study.name,
            f"{names}: running, though the process is no more",
            "--repair frees what it held; studies tune trains it again with the same hyperparameters",
            partial(_free, study),
        )
    if study.best is not None and not study.is_busy:
        yield from _weights(study, study.best)


def _weights(study: KeptStudy, best: TrialRecord) -> Iterator[StoreFinding]:
    """Check the weights of the best trial."""
    champion = study.paths.champion(study.entry.label, study.entry.n_train)
    with tempfile.TemporaryDirectory() as scratch:
        kept = study.store.fetch_surrogate(best.index, Path(scratch))
        weights = Path(scratch) / WEIGHTS_FILE
        is_whole = kept and weights.is_file()
        if is_whole and best.weights_sha256 and file_digest(weights) != best.weights_sha256:
            is_whole = False
    if is_whole:
        return
    what = "are not what was written (sha256 differs)" if kept else "are missing"
    has_copy = _is_copy(champion, best)
    yield StoreFinding(
        STORE,
        "bad",
        best.key,
        f"the weights of the best trial {what}",
        "--repair takes the champion's copy"
        if has_copy
        else f"studies reproduce --keep {best.key} trains them again, in mlruns/reproduced",
        partial(_restore_weights, study, best, champion) if has_copy else None,
    )


def _is_copy(champion: Path, best: TrialRecord) -> bool:
    """Return whether a champion's folder holds the weights of a trial."""
    try:
        told = read_champion(champion)
    except InputError:
        return False
    is_same = not best.weights_sha256 or told.files_sha256[WEIGHTS_FILE] == best.weights_sha256
    return (told.study, told.index) == (best.study, best.index) and is_same


def _restore_weights(study: KeptStudy, best: TrialRecord, champion: Path) -> str:
    folder = Path(study.store.place) / trial_name(best.index) / "surrogate"
    if not folder.parent.is_dir():
        return f"{best.key}: its weights lie in a database; the champion's folder {champion} has them"
    scratch = folder.with_name(f".{folder.name}-new")
    shutil.rmtree(scratch, ignore_errors=True)
    shutil.copytree(champion, scratch, ignore=shutil.ignore_patterns(CHAMPION_FILE))
    shutil.rmtree(folder, ignore_errors=True)
    scratch.rename(folder)
    return f"{best.key}: weights taken from {study.paths.show(champion)}"


def _set_trial_aside(study: KeptStudy, index: int) -> str:
    folder = Path(study.store.place)
    place = free_name(folder / SET_ASIDE / trial_name(index))
    place.parent.mkdir(exist_ok=True)
    with study.store.lock():
        (folder / trial_name(index)).rename(place)
    return f"{study.name}/{trial_name(index)}: kept in {study.paths.show(place)}"


def _write_reports(study: KeptStudy, record: TrialRecord) -> str:
    """Write the learning curve that a record's reports tell, in the place of the damaged one."""
    folder = Path(study.store.place) / trial_name(record.index)
    if not folder.is_dir():
        return f"{record.key}: its curves lie in a database, which must be restored from a copy"
    curve = sorted((int(step), value) for step, value in record.reports.items())
    if (file := folder / HISTORY_FILE).is_file():
        file.replace(free_name(folder / f"{HISTORY_FILE}{SET_ASIDE}"))
    scratch = folder / f".{HISTORY_FILE}.tmp.npz"
    np.savez_compressed(
        scratch,
        allow_pickle=False,
        epoch=np.array([step for step, _ in curve], dtype=np.int64),
        validation_mae=np.array([value for _, value in curve], dtype=np.float64),
    )
    scratch.rename(file)
    return f"{record.key}: {count(len(curve), 'point')} of the validation error written from its record"


def _free(study: KeptStudy) -> str:
    with study.store.lock():
        for claim in study.dead_claims:
            if any(other.token == claim.token for other, _ in study.store.claims()):
                study.store.put_claim(claim.released(lost=True))
    return f"{study.name}: {listed([trial_name(c.index) for c in study.dead_claims])} freed"


def check_results(stores: Stores) -> Iterator[StoreFinding]:
    """Read the manifests and numbers of all stages, and look for their files."""
    paths, n_read, found = stores.paths, 0, []
    for file in sorted((paths.mlruns / "results").glob("*/*.json")):
        n_read += 1
        try:
            manifest = json.loads(file.read_text(encoding="utf-8"))
            files = manifest.get("files", {}) if isinstance(manifest, dict) else {}
        except (OSError, ValueError) as error:
            remedy = "--repair keeps it aside; type the command of the stage again"
            found.append(_damaged_result(stores, file, f"cannot be read ({error})", remedy))
            continue
        lost = [name for name, size in files.items() if not _has_size(paths.root / name, size)]
        if lost:
            stage = file.stem.partition("-")[0]
            found.append(
                StoreFinding(
                    "results",
                    "bad",
                    f"{file.parent.name}/{file.stem}",
                    f"{count(len(lost), 'file')} of it missing or changed: {listed(lost)}",
                    f"type studies {stage} again: it does what is missing",
                )
            )
    for file in sorted((paths.mlruns / "results").glob("*/*.npz")):
        n_read += 1
        try:
            with file.open("rb") as stream, np.load(stream, allow_pickle=False) as content:
                for name in content.files:
                    content[name]
        except (*DAMAGE, OSError) as error:
            remedy = "--repair keeps it aside; type the command of the stage again"
            found.append(_damaged_result(stores, file, f"cannot be read ({type(error).__name__})", remedy))
    yield from found
    if not found and n_read:
        yield ok("results", "mlruns/results", f"{count(n_read, 'file')}, all readable and complete")


def _damaged_result(stores: Stores, file: Path, found: str, remedy: str) -> StoreFinding:
    def repair() -> str:
        place = free_name(file.parent / SET_ASIDE / file.name)
        place.parent.mkdir(exist_ok=True)
        file.replace(place)
        return f"{stores.paths.show(file)}: kept in {stores.paths.show(place)}"

    return StoreFinding("results", "bad", stores.paths.show(file), found, remedy, repair)


def _has_size(file: Path, size: int) -> bool:
    return file.is_file() and file.stat().st_size == size


def free_name(place: Path) -> Path:
    """Return a name that nothing has yet."""
    n, candidate = 1, place
    while candidate.exists():
        n += 1
        candidate = place.with_name(f"{place.name}-{n}")
    return candidate
