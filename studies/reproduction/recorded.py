"""What was recorded of a result, found by any of its names."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.recipe import Recipe, checked, file_digest
from studies.stages.pipeline import read_json
from studies.stages.results import read_arrays
from studies.tuning.trial_record import TrialRecord, best_record, trial_name
from studies.tuning.trial_store import StudyEntry, TrialStore, list_studies, open_trials

Arrays = Mapping[str, NDArray[Any]]

_TRIAL = re.compile(r"(?P<study>.+/n\d+(?:/[0-9a-f]{8})?)/t(?P<index>\d+)")
_STUDY = re.compile(r"(?P<label>[^/]+)/(?P<size>n\d+)(?:/(?P<digest>[0-9a-f]{8}))?")
_STAGE = re.compile(
    r"(?P<label>[^/ ]+)[/ ](?:calibrat(?:e|ion)-)?(?P<what>n\d+|adaptive|sensitivity)(?P<word> calibration)?"
)
_SPOKEN = "a run's id, office-quick/n0064/t003, office-quick/n0064, office-quick/calibrate-n0064"


@dataclass(frozen=True)
class Recorded:
    """A result as it was recorded.

    Args:
        name: what it is called.
        place: where the record was found, for the user.
        recipe: what rebuilds it.
        environment: versions, machine and code that made it; empty where they were not recorded.
        numbers: its numbers, as nested JSON values.
        arrays: its curves and trajectories, by name.
        trial: the trial's record, where it is a training.
        rivals: the trials of the same study that are recorded, ordered by index.
    """

    name: str
    place: str
    recipe: Recipe
    environment: Mapping[str, str]
    numbers: Mapping[str, Any]
    arrays: Arrays
    trial: TrialRecord | None = None
    rivals: tuple[TrialRecord, ...] = field(default=())

    @property
    def kind(self) -> str:
        """What it is: training, calibration, adaptive or sensitivity."""
        return str(self.recipe["kind"])


def find_recorded(paths: ProjectPaths, run: str) -> Recorded:
    """Find what a name means: a trial, a study (its best trial), a stage, or MLflow's id of any of them.

    Raises:
        InputError: nothing is called so, or its record does not tell how it was made.
    """
    run = run.strip().strip("/")
    if found := _TRIAL.fullmatch(run):
        entry = _study(paths, found["study"])
        return _trial(paths, entry, int(found["index"]))
    if found := _STAGE.fullmatch(run):
        is_study = _STUDY.fullmatch(run) and not found["word"]
        if not is_study:
            return recorded_stage(paths, found["label"], found["what"])
    if _STUDY.fullmatch(run):
        entry = _study(paths, run)
        best = best_record(open_trials(paths, entry.name).records())
        if best is None:
            raise InputError(f"{entry.name} has no completed trial; name one, such as {entry.name}/t000")
        return _trial(paths, entry, best.index)
    if re.fullmatch(r"[0-9a-f]{4,32}", run):
        from studies.reproduction.mlflow_records import find_run

        return find_run(paths, run)
    raise InputError(f"{run!r} is no run; give {_SPOKEN}")


def recorded_trial(entry: StudyEntry, store: TrialStore, record: TrialRecord, *, place: str = "") -> Recorded:
    """Return a trial as its store has it.

    Raises:
        InputError: the study was recorded without a recipe.
    """
    return Recorded(
        name=record.key,
        place=place or store.place,
        recipe=checked(entry.recipe, entry.name),
        environment=record.environment,
        numbers=numbers_of(record),
        arrays=store.history(record.index),
        trial=record,
        rivals=tuple(store.records()),
    )


def numbers_of(record: TrialRecord) -> dict[str, Any]:
    """Return the numbers of a trial that must come out again."""
    return {
        "state": record.state,
        **record.metrics,
        "n_rows": record.n_rows,
        "n_epochs": record.n_epochs,
        "best_epoch": record.best_epoch,
        "reports": record.reports,
        **({"weights": record.weights_sha256} if record.weights_sha256 else {}),
        "reason": record.reason,
    }


def recorded_stage(paths: ProjectPaths, label: str, what: str) -> Recorded:
    """Return a calibration or the Sobol indices as they lie in the project.

    Args:
        paths: the project.
        label: label of case and profile.
        what: "n0064", "adaptive" or "sensitivity".

    Raises:
        InputError: there is no such stage, or its files are damaged.
    """
    folder = paths.results(label)
    is_sensitivity = what == "sensitivity"
    file = folder / ("sensitivity.json" if is_sensitivity else f"calibration-{what}.json")
    arrays = file.with_suffix(".npz")
    content = read_json(file)
    if content is None or not arrays.is_file():
        known = [one.stem for one in sorted(folder.glob("calibration-*.json"))]
        known += [one.stem for one in folder.glob("sensitivity.npz")]
        raise InputError(
            f"{label} has no finished {what}; it has {', '.join(known) or 'none'} (studies status shows all)"
        )
    numbers = content["summary"] if is_sensitivity else content
    return stage_record(f"{label}/{file.stem}", content, numbers, read_arrays(arrays), place=paths.show(file))


def stage_record(
    name: str, content: Mapping[str, Any], numbers: Mapping[str, Any], arrays: Arrays, *, place: str
) -> Recorded:
    """Return a stage of which the files are read."""
    return Recorded(
        name=name,
        place=place,
        recipe=checked(content.get("recipe", {}), name),
        environment=content.get("environment", {}),
        numbers=stage_numbers(numbers),
        arrays=arrays,
    )


def stage_numbers(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out of a stage's numbers what is no result: names, notes, places."""
    told = ("label", "note", "recipe", "environment", "file", "settings", "method", "seed", "n_train")
    return {name: value for name, value in numbers.items() if name not in told}


def weights_digest(folder: Path) -> str:
    """Return the SHA-256 of a saved surrogate's weights."""
    return file_digest(folder / "weights.npz")


def _study(paths: ProjectPaths, name: str) -> StudyEntry:
    """Return a study by its whole name, or the newest of a label and size."""
    entries = list_studies(paths)
    found = [entry for entry in entries if name in (entry.name, entry.name.rpartition("/")[0])]
    if not found:
        known = sorted({entry.name.rpartition("/")[0] for entry in entries})
        raise InputError(f"there is no study {name}; there are {', '.join(known) or 'none'}")
    return max(found, key=lambda entry: entry.created_s)


def _trial(paths: ProjectPaths, entry: StudyEntry, index: int) -> Recorded:
    store = open_trials(paths, entry.name)
    record = store.record(index)
    if record is None:
        finished = ", ".join(trial_name(one) for one in store.finished()) or "none"
        raise InputError(f"{entry.name} has no finished trial {trial_name(index)}; it has {finished}")
    return recorded_trial(entry, store, record, place=_shown(paths, store.place, index))


def _shown(paths: ProjectPaths, place: str, index: int) -> str:
    folder = Path(place)
    return paths.show(folder / trial_name(index)) if folder.is_dir() else place


def as_arrays(curves: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return lists of numbers as arrays."""
    return {name: np.asarray(curve, dtype=np.float64) for name, curve in curves.items()}
