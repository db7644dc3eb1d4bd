"""Are the champions there, whole, and the best of their studies."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from simulation.errors import InputError
from studies.keeping.check_records import SET_ASIDE, free_name
from studies.keeping.finding import StoreFinding, ok
from studies.keeping.stores import KeptStudy, Stores
from studies.paths import size_name
from studies.report.wording import count
from studies.tuning.champion import CHAMPION_FILE, SCHEMA, crown, read_champion, restore_champion

STORE = "champions"


def check_champions(stores: Stores) -> Iterator[StoreFinding]:
    """Read every champion, and look for those that should be there."""
    paths, found, n_sound = stores.paths, [], 0
    folders = {file.parent for file in (paths.mlruns / "champions").glob(f"*/*/{CHAMPION_FILE}")}
    folders |= {paths.champion(study.entry.label, study.entry.n_train) for study in newest(stores)}
    for folder in sorted(folders):
        one = list(_champion(stores, folder))
        found += one
        n_sound += not one
    yield from found
    if n_sound and not found:
        yield ok(STORE, "mlruns/champions", f"{count(n_sound, 'folder')}, whole, the best of their studies")


def newest(stores: Stores) -> list[KeptStudy]:
    """Return the study of each label and size that has a best trial and was asked for last."""
    found: dict[tuple[str, int], KeptStudy] = {}
    for study in sorted(stores.studies, key=lambda one: one.entry.created_s):
        if study.best is not None:
            found[study.entry.label, study.entry.n_train] = study
    return list(found.values())


def _champion(stores: Stores, folder: Path) -> Iterator[StoreFinding]:
    where = stores.paths.show(folder)
    owners = [
        study
        for study in newest(stores)
        if (study.entry.label, size_name(study.entry.n_train)) == (folder.parent.name, folder.name)
    ]
    owner = owners[0] if owners else None
    if owner is not None and owner.is_busy:
        return
    if not folder.is_dir():
        old = sorted(folder.parent.glob(f".{folder.name}-old-*"))
        if old:
            yield StoreFinding(
                STORE,
                "bad",
                where,
                "was being replaced when a process was killed",
                "--repair puts it back",
                partial(_put_back, stores, old[-1], folder),
            )
        elif owner is not None and len(owner.records) >= owner.entry.n_planned:
            yield _missing(stores, owner, where, "is missing though its study is finished")
        return
    try:
        told = read_champion(folder)
    except InputError as error:
        if _schema(folder) not in (None, SCHEMA):
            return  # said among the versions
        yield StoreFinding(
            STORE,
            "bad",
            where,
            str(error).partition(";")[0],
            "--repair writes it again from the trial" if owner else "studies tune writes it again",
            partial(_replace, stores, folder, owner) if owner else None,
        )
        return
    study = stores.by_name.get(told.study)
    if study is None:
        yield StoreFinding(STORE, "note", where, f"its study {told.study} has no records here")
    elif study.best is not None and study.best.index != told.index and study is owner:
        if told.index in {record.index for record in study.records}:
            yield _missing(stores, study, where, f"is trial {told.index}, trial {study.best.index} is better")
        else:
            lost = f"is trial {told.index}, whose record is lost"
            yield StoreFinding(STORE, "note", where, lost, "studies tune trains it again")


def _missing(stores: Stores, study: KeptStudy, where: str, found: str) -> StoreFinding:
    remedy = "--repair writes it from the best trial"
    return StoreFinding(STORE, "bad", where, found, remedy, partial(_crown, stores, study))


def _schema(folder: Path) -> object:
    try:
        return json.loads((folder / CHAMPION_FILE).read_text(encoding="utf-8")).get("schema")
    except (OSError, ValueError, AttributeError):
        return None


def _crown(stores: Stores, study: KeptStudy) -> str:
    from studies.keeping.views import tracker_of

    place = stores.paths.champion(study.entry.label, study.entry.n_train)
    where = stores.paths.show(place)
    if study.best is not None and crown(stores.paths, study.spec, study.best):
        return f"{where}: written from trial {study.best.index} of {study.name}"
    if not place.is_dir():
        tracker, label, n_train = tracker_of(stores.paths), study.entry.label, study.entry.n_train
        if restore_champion(
            stores.paths, label, n_train, lambda folder: tracker.fetch_champion(label, n_train, folder)
        ):
            return f"{where}: fetched from MLflow's registry"
    best = study.best.key if study.best else study.name
    return f"{where}: the weights are nowhere; type: studies reproduce {best}"


def _replace(stores: Stores, folder: Path, owner: KeptStudy) -> str:
    if _mend(folder, owner):
        return f"{stores.paths.show(folder)}: its damaged files taken from the trial's"
    place = free_name(folder.parent / SET_ASIDE / folder.name)
    place.parent.mkdir(exist_ok=True)
    folder.rename(place)
    return f"{stores.paths.show(folder)}: kept in {stores.paths.show(place)}; {_crown(stores, owner)}"


def _mend(folder: Path, owner: KeptStudy) -> bool:
    """Take a champion's damaged files from its trial where that has them; return whether it is whole now."""
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".mended-", suffix="-new") as scratch:
        whole = Path(scratch)
        try:
            told = json.loads((folder / CHAMPION_FILE).read_text(encoding="utf-8"))
            if told["study"] != owner.name or not owner.store.fetch_surrogate(int(told["index"]), whole):
                return False
            shutil.copy2(folder / CHAMPION_FILE, whole)
            read_champion(whole)
        except (OSError, ValueError, KeyError, TypeError, InputError):
            return False
        for file in whole.iterdir():
            file.replace(folder / file.name)
    return True


def _put_back(stores: Stores, old: Path, folder: Path) -> str:
    old.rename(folder)
    return f"{stores.paths.show(folder)}: put back"
