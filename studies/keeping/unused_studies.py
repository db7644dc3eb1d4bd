"""Studies that nothing needs any more: superseded ones, and those whose case or profile is gone."""

import shlex
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from simulation.errors import InputError
from studies.keeping.check_champions import newest
from studies.keeping.leftover import Leftover
from studies.keeping.optuna_view import forget_optuna
from studies.keeping.scratch import size_of
from studies.keeping.stores import KeptStudy, Stores, read_study
from studies.keeping.views import remove_folder, tracker_of
from studies.paths import ProjectPaths, find_case
from studies.profile import load_profile
from studies.stages.pipeline import read_json
from studies.tracking.mlflow_registry import model_name
from studies.tuning.champion import CHAMPION_FILE
from studies.tuning.trial_record import SURROGATE_FOLDER, trial_name

SUPERSEDED, GONE, WEIGHTS = "superseded studies", "studies without case or profile", "weights of other trials"


def unused_studies(stores: Stores) -> Iterator[Leftover]:
    """Find studies that may go; one that somebody works on never may."""
    needed = _referenced(stores) | {study.name for study in newest(stores)}
    last = {(study.entry.label, study.entry.n_train): study for study in stores.studies}
    for study in stores.studies:
        if study.is_busy:
            continue
        why = _gone(stores.paths, study)
        kind = GONE if why else SUPERSEDED
        if not why and study.name not in needed:
            successor = last[study.entry.label, study.entry.n_train]
            if successor is study:
                continue  # nothing finished yet, but nothing newer either
            why = f"{successor.name.rpartition('/')[2]} has its place: data or settings changed"
        if why:
            changed_s = max((record.ended_s for record in study.records), default=study.entry.created_s)
            yield Leftover(kind, study.name, why, _size(study), changed_s, partial(remove_study, study))


def unused_weights(stores: Stores) -> Iterator[Leftover]:
    """Find weights of trials that are not the best of their study."""
    for study in stores.studies:
        folder = Path(study.store.place)
        if study.is_busy or not folder.is_dir():
            continue
        best = trial_name(study.best.index) if study.best else ""
        others = [one for one in sorted(folder.glob(f"t*/{SURROGATE_FOLDER}")) if one.parent.name != best]
        if others:
            yield Leftover(
                WEIGHTS,
                f"{study.name}: {len(others)}",
                f"{best or 'none'} is the best trial; the records stay",
                sum(size_of(one) for one in others),
                max(one.stat().st_mtime for one in others),
                partial(_keep_best, study),
            )


def remove_study(study: KeptStudy) -> str:
    """Remove a study from everywhere, its records last; return why not where somebody works on it."""
    paths, entry = study.paths, study.entry
    if read_study(paths, entry).is_busy:
        return "somebody works on it now"
    with study.store.lock():
        forget_optuna(paths, study.name)
        if paths.storage is not None or paths.tracking_database.is_file():
            _remove_from_mlflow(study)
        champion = paths.champion(entry.label, entry.n_train)
        if (read_json(champion / CHAMPION_FILE) or {}).get("study") == study.name:
            remove_folder(champion)
        tuning = paths.results(entry.label) / "tune.json"
        told = (read_json(tuning) or {}).get("summary", {}).get("studies", [])
        if any(one.get("study") == study.name for one in told):
            tuning.unlink()  # a finished stage has its champions
        _remove_records(study)
    return ""


def _remove_from_mlflow(study: KeptStudy) -> None:
    """Put the runs of a study into MLflow's bin, and take its models out of the registry."""
    tracker, entry = tracker_of(study.paths), study.entry
    client = tracker.client
    with tracker.runs.lock(study.name):
        name = model_name(entry.label, entry.n_train)
        versions = client.search_model_versions(f"name = '{name}'")
        for version in versions:
            if version.tags.get("study_key") == study.name:
                client.delete_model_version(name, version.version)
        if versions and not client.search_model_versions(f"name = '{name}'"):
            client.delete_registered_model(name)
        for run in tracker.runs.find(entry.label, {"study_key": study.name}):
            client.delete_run(run.info.run_id)


def _remove_records(study: KeptStudy) -> None:
    if study.paths.storage is None:
        folder = Path(study.store.place)
        for one in folder.glob(".gone-*"):
            shutil.rmtree(one, ignore_errors=True)
        remove_folder(folder)
        return
    from studies.tuning.postgres import database

    for table, column in (("studies", "name"), ("claims", "study"), ("trials", "study")):
        database(study.paths.storage).rows(f"delete from studies.{table} where {column} = %s", [study.name])


def _keep_best(study: KeptStudy) -> str:
    if read_study(study.paths, study.entry).is_busy:
        return "somebody works on it now"
    study.store.keep_only_best()
    return ""


def _referenced(stores: Stores) -> set[str]:
    """Return the studies that manifests, champions and calibrations name."""
    paths, found = stores.paths, set()
    for file in (paths.mlruns / "champions").glob(f"*/*/{CHAMPION_FILE}"):
        found.add((read_json(file) or {}).get("study", ""))
    for file in (paths.mlruns / "results").glob("*/*.json"):
        content = read_json(file) or {}
        summary = content.get("summary") or content
        found |= {one.get("study", "") for one in summary.get("studies", [])}
        found.add((summary.get("surrogate") or {}).get("study", ""))
    return found


def _gone(paths: ProjectPaths, study: KeptStudy) -> str:
    """Say what a study was made for and is there no more."""
    recipe, case = study.entry.recipe, study.entry.case_name
    place = recipe.get("case", {}).get("place", "")
    if not (place and (paths.root / place).is_file()):
        try:
            find_case(paths, case)
        except InputError:
            return f"its case {case} is no more"
    words = shlex.split(str(recipe.get("command", "")))
    profile = words[words.index("--profile") + 1] if "--profile" in words[:-1] else ""
    if profile and not (paths.root / profile).is_file():
        try:
            load_profile(profile)
        except InputError as error:
            if "there is no profile" in str(error):
                return f"its profile {profile} is no more"
    return ""


def _size(study: KeptStudy) -> int:
    folder = Path(study.store.place)
    if folder.is_dir():
        return size_of(folder)
    if study.paths.storage is None:
        return 0
    from studies.tuning.postgres import database

    ((size,),) = database(study.paths.storage).rows(
        "select coalesce(sum(length(history) + coalesce(length(surrogate), 0) + length(record::text)), 0) "
        "from studies.trials where study = %s",
        [study.name],
    )
    return int(size)
