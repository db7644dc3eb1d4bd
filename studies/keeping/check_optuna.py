"""Does Optuna tell the same of every study as the records."""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from simulation.errors import InputError
from studies.keeping.check_records import free_name
from studies.keeping.finding import StoreFinding, listed, ok
from studies.keeping.optuna_view import OptunaTrial, forget_optuna, has_optuna, read_optuna, rebuild_optuna
from studies.keeping.stores import KeptStudy, Stores
from studies.report.wording import count
from studies.tuning.study_store import JOURNAL
from studies.tuning.trial_record import trial_name

STORE = "Optuna"
_REMEDY = "--repair writes the study again from its records"


def check_optuna(stores: Stores) -> Iterator[StoreFinding]:
    """Compare every study with its records."""
    paths = stores.paths
    if not has_optuna(paths):
        if stores.studies:
            remedy = "--repair writes it from the records"
            yield StoreFinding(
                STORE, "bad", f"mlruns/{JOURNAL}", "there is none yet", remedy, partial(_rebuild_all, stores)
            )
        return
    try:
        views = read_optuna(paths)
    except InputError as error:
        journal = paths.mlruns / JOURNAL
        repair = partial(_replace_journal, stores, journal) if paths.storage is None else None
        remedy = "--repair keeps it aside and writes a new one" if repair else "see what is said"
        yield StoreFinding(STORE, "bad", paths.show(journal), str(error), remedy, repair)
        return
    found = [one for study in stores.studies for one in _study(study, views.get(study.name))]
    for name in sorted(set(views) - set(stores.by_name)):
        n_trials = len(views[name])
        if n_trials == 0:
            continue
        found.append(
            StoreFinding(
                STORE,
                "bad",
                name,
                f"{count(n_trials, 'trial')} of a study that has no records",
                "--repair removes it from Optuna; or bring the records back (mlruns/trials)",
                partial(_forget, stores, name),
            )
        )
    yield from found
    if not found:
        n_trials = sum(len(study.records) for study in stores.studies)
        studies = count(len(stores.studies), "study", "studies")
        yield ok(STORE, "all studies", f"{studies}, {count(n_trials, 'trial')}, as the records say")


def _study(study: KeptStudy, view: Sequence[OptunaTrial] | None) -> Iterator[StoreFinding]:
    wrong = list(_differences(study, view or ()))
    if wrong and study.is_busy:
        yield StoreFinding(STORE, "note", study.name, f"{wrong[0]}; it is being tuned at the moment")
    elif wrong:
        yield StoreFinding(STORE, "bad", study.name, "; ".join(wrong), _REMEDY, partial(_rebuild, study))


def _differences(study: KeptStudy, view: Sequence[OptunaTrial]) -> Iterator[str]:
    records = {record.index: record for record in study.records}
    finished = [trial for trial in view if trial.state not in ("running", "waiting")]
    indices = Counter(trial.index for trial in finished)
    yield from _named(
        [trial.number for trial in view if trial.state == "running"], "runs for ever", "{} run for ever"
    )
    lost = sorted(set(records) - set(indices))
    if lost and not view:
        yield "it is not there"
    else:
        yield from _named(lost, "is missing", "{} are missing")
    yield from _named(sorted(set(indices) - set(records)), "has no record", "{} have no record")
    yield from _named(sorted(i for i, n in indices.items() if n > 1), "is there twice", "{} are there twice")
    states = [
        trial.index
        for trial in finished
        if trial.index in records and trial.state != records[trial.index].state
    ]
    yield from _named(states, "ended otherwise", "{} ended otherwise")
    values = [
        trial.index
        for trial in finished
        if trial.index in records
        and trial.state == "complete" == records[trial.index].state
        and trial.value != records[trial.index].value
    ]
    yield from _named(values, "has another error", "{} have other errors")


def _named(indices: Sequence[int], one: str, several: str) -> Iterator[str]:
    if indices:
        names = listed([trial_name(index) for index in indices])
        yield f"{names} {one}" if len(indices) == 1 else several.format(names)


def _rebuild(study: KeptStudy) -> str:
    rebuild_optuna(study)
    return f"{study.name}: {count(len(study.records), 'trial')} written to Optuna again"


def _rebuild_all(stores: Stores) -> str:
    for study in stores.studies:
        rebuild_optuna(study)
    return f"{count(len(stores.studies), 'study', 'studies')} written to Optuna"


def _replace_journal(stores: Stores, journal: Path) -> str:
    place = free_name(journal.with_name(f"{journal.name}.damaged"))
    journal.replace(place)
    return f"the damaged journal is kept in {stores.paths.show(place)}; {_rebuild_all(stores)}"


def _forget(stores: Stores, name: str) -> str:
    forget_optuna(stores.paths, name)
    return f"{name} removed from Optuna"
