"""What was recorded of a result, found by any of its names."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.errors import InputError
from studies.looking.names import find_thing, kind_of
from studies.looking.project import StageLook, StudyLook, look_at
from studies.looking.things import TrialThing
from studies.paths import ProjectPaths
from studies.recipe import Recipe, checked, file_digest
from studies.stages.pipeline import read_json
from studies.stages.results import read_arrays
from studies.tuning.trial_record import TrialRecord

Arrays = Mapping[str, NDArray[Any]]
REPEATABLE = "trials, studies, calibrations, their uncertainty and sensitivity"
"""What can be made again, in words."""


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
        """What it is: training, calibration, adaptive, uncertainty or sensitivity."""
        return str(self.recipe["kind"])


def find_recorded(paths: ProjectPaths, run: str) -> Recorded:
    """Find what a name means: a trial, a study (its best trial), a stage, or MLflow's id of any of them.

    Raises:
        InputError: nothing is called so, or its record does not tell how it was made.
    """
    if re.fullmatch(r"[0-9a-f]{4,32}", run):
        from studies.reproduction.mlflow_records import find_run

        found = find_run(paths, run)
        if found is not None:
            return found
    thing = find_thing(look_at(paths), _as_named(run))
    if isinstance(thing, TrialThing):
        return recorded_trial(paths, thing.study, thing.record)
    if isinstance(thing, StudyLook):
        if thing.best is None:
            raise InputError(f"{thing.name} has no completed trial; name one, such as {thing.called}/t000")
        return recorded_trial(paths, thing, thing.best)
    if isinstance(thing, StageLook):
        stem = _file_stem(thing.stage)
        if stem is not None:
            return recorded_stage(paths, thing.label, stem)
    raise InputError(f"{run!r} is a {kind_of(thing)}; {REPEATABLE} can be made again")


def _file_stem(stage: str) -> str | None:
    """Return what the files of a stage are called, None for one that is not made again."""
    what, _, name = stage.partition("-")
    return {
        "sensitivity": "sensitivity",
        "calibrate": f"calibration-{name}",
        "uncertainty": f"posterior-{name}",
    }.get(what)


def _as_named(run: str) -> str:
    """Return the name of what people call `office-quick/n0064 calibration` or `office-quick adaptive`."""
    run = re.sub(r"[/ ]((adaptive|n\d{4,})(-relevant\d+)?) uncertainty$", r"/uncertainty-\1", run.strip())
    run = re.sub(r"[/ ]adaptive(-relevant\d+)?( calibration)?$", r"/calibrate-adaptive\1", run)
    return re.sub(
        r"[/ ]n(\d+)(-relevant\d+)? calibration$",
        lambda found: f"/calibrate-n{int(found[1]):04d}{found[2] or ''}",
        run,
    )


def recorded_trial(paths: ProjectPaths, study: StudyLook, record: TrialRecord) -> Recorded:
    """Return a trial as its store has it.

    Raises:
        InputError: the study was recorded without a recipe.
    """
    return Recorded(
        name=record.key,
        place=paths.show(place) if (place := Path(study.store.place)).is_dir() else study.store.place,
        recipe=checked(study.entry.recipe, study.name),
        environment=record.environment,
        numbers=numbers_of(record),
        arrays=study.store.history(record.index),
        trial=record,
        rivals=study.records,
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


def recorded_stage(paths: ProjectPaths, label: str, stem: str) -> Recorded:
    """Return a calibration, its uncertainty or the Sobol indices as they lie in the project.

    Args:
        paths: the project.
        label: label of case and profile.
        stem: name of its files, as "calibration-n0064", "posterior-adaptive" or "sensitivity".

    Raises:
        InputError: there is no such stage, or its files are damaged.
    """
    folder = paths.results(label)
    file = folder / f"{stem}.json"
    arrays = file.with_suffix(".npz")
    content = read_json(file)
    if content is None or not arrays.is_file():
        known = [one.stem for one in sorted(folder.glob("calibration-*.json"))]
        known += [one.stem for what in ("posterior-*.json", "sensitivity.npz") for one in folder.glob(what)]
        raise InputError(
            f"{label} has no finished {stem}; it has {', '.join(known) or 'none'} (studies status shows all)"
        )
    numbers = content["summary"] if stem == "sensitivity" else content
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


def as_arrays(curves: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return lists of numbers as arrays."""
    return {name: np.asarray(curve, dtype=np.float64) for name, curve in curves.items()}
