"""Write Optuna's and MLflow's views of the studies, and the champions, again from the records."""

import shutil
import tempfile
from collections.abc import Callable
from datetime import datetime
from functools import cache
from pathlib import Path

from simulation.errors import InputError
from studies.keeping.stores import KeptStudy
from studies.keeping.versions import require_mlflow_version
from studies.paths import ProjectPaths
from studies.tracking.mlflow_tracker import MlflowTracker
from studies.tracking.tracker import History
from studies.tuning.champion import read_champion, write_champion
from studies.tuning.trial_record import SURROGATE_FOLDER, TrialRecord, summarize, trial_name


@cache
def tracker_of(paths: ProjectPaths) -> MlflowTracker:
    """Return the way to the project's MLflow, opened once: it costs seconds.

    Raises:
        InputError: another version of MLflow wrote its database.
    """
    require_mlflow_version(paths)
    return MlflowTracker(paths)


def write_to_mlflow(study: KeptStudy) -> None:
    """Tell MLflow of a study, its trials and its champion; what it knows already stays.

    Raises:
        InputError: the champion cannot be read.
    """
    require_mlflow_version(study.paths)
    tracker = MlflowTracker(study.paths)  # a new one: it remembers runs that may have been removed since
    spec, store = study.spec, study.store
    tracker.start_study(spec, n_trials=len(study.records))
    for record in study.records:
        tracker.log_trial(spec, record, _history(study, record))
    champion = study.paths.champion(spec.label, spec.n_train)
    is_champion = False
    if (champion / "champion.json").is_file():
        is_champion = read_champion(champion).study == study.name
        if is_champion:
            tracker.register_champion(spec, champion)
    is_done = len(store.finished()) >= study.entry.n_planned
    summary = summarize(spec, study.records, champion if is_champion else None)
    tracker.finish_study(spec, summary, "FINISHED" if is_done else "KILLED")


def _history(study: KeptStudy, record: TrialRecord) -> Callable[[], History]:
    return lambda: study.store.history(record.index)


def crown(study: KeptStudy, best: TrialRecord) -> bool:
    """Make a study's best surrogate the champion of its size; return whether its weights are there."""
    folder = study.paths.champion(study.entry.label, study.entry.n_train)
    with tempfile.TemporaryDirectory(prefix="studies-champion-") as scratch:
        surrogate = Path(scratch) / trial_name(best.index) / SURROGATE_FOLDER
        surrogate.mkdir(parents=True)
        if not study.store.fetch_surrogate(best.index, surrogate):
            return False
        write_champion(study.spec, best, study_folder=Path(scratch), folder=folder)
    return True


def write_stages(paths: ProjectPaths, label: str) -> list[str]:
    """Tell MLflow of the finished calibrations of a label; what it knows already stays.

    Returns:
        What could not be told, a line each.
    """
    from simulation.case import load_case
    from studies.console import Console
    from studies.profile import profile_from
    from studies.recipe import checked
    from studies.stages.pipeline import Study, read_json
    from studies.stages.results import ADAPTIVE, stored_calibrations
    from studies.stages.tracking import log_adaptive, log_calibration

    left = []
    for file in sorted(paths.results(label).glob("calibration-*.json")):
        name = file.stem.removeprefix("calibration-")
        numbers, manifest = read_json(file), read_json(file.with_name(f"calibrate-{name}.json"))
        if numbers is None or manifest is None:
            continue
        try:
            recipe = checked(numbers.get("recipe", {}), f"{label}/{file.stem}")
            begin, end = recipe["window_d"]
            study = Study(
                case=load_case(paths.root / recipe["case"]["place"], window_d=(begin, end)),
                profile=profile_from(recipe["profile"], file.stem),
                paths=paths,
                console=Console(quiet=True),
                n_jobs=1,
                label=label,
                command=str(recipe["command"]),
            )
        except InputError as error:
            left.append(f"{label}/{file.stem} is not shown in MLflow: {error}")
            continue
        stored = {one.files.numbers: one for one in stored_calibrations(study)}.get(file)
        if stored is None:
            left.append(
                f"{label}/{file.stem} is not shown in MLflow: the case {study.case.name} has changed since"
            )
            continue
        wall_s = float(manifest["wall_s"])
        started_s = datetime.fromisoformat(manifest["finished"]).timestamp() - wall_s
        log = log_adaptive if name == ADAPTIVE else log_calibration
        log(study, stored, manifest["digest"], started_s=started_s, wall_s=wall_s)
    return left


def remove_folder(folder: Path) -> None:
    """Remove a folder so that it is there as a whole or gone: first it gets a name nobody reads."""
    trash = folder.with_name(f".gone-{folder.name}")
    shutil.rmtree(trash, ignore_errors=True)
    folder.rename(trash)
    shutil.rmtree(trash)
