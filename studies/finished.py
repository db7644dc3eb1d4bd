"""The finished calibrations of a project, as `status` and `best` show them, and what changed since."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.foreign_file import parse_toml
from studies.paths import ProjectPaths
from studies.recipe import file_digest
from studies.report.records_tuning import TunedSize
from studies.report.wording import difference_unit, squared
from studies.stages.pipeline import read_json
from studies.tuning.results import TunedStudy, read_studies

FIRST_WORDS = "type: studies run (the office, some minutes), or studies new for a case of your own"


@dataclass(frozen=True)
class Calibration:
    """A finished calibration; as JSON values it is what programs read.

    Args:
        case: name of its case.
        label: label of the study.
        name: what it is called on a command line.
        mse: its final error; None where it failed. [unit]
        unit: first output's unit squared.
        n_calls_paper: model calls in the paper's count.
        n_calls_all: all model calls.
        n_known: stored simulations that it began with, which are none of its calls.
        theta: the calibrated parameters. [units]
        units: their units.
        reason: why it ended.
        finished: when, UTC.
        changed_since: files that it was made from and that hold something else now.
        made_of: SHA-256 of its case and measurement.
    """

    case: str
    label: str
    name: str
    mse: float | None
    unit: str
    n_calls_paper: int
    n_calls_all: int
    n_known: int
    theta: Mapping[str, float]
    units: Mapping[str, str]
    reason: str
    finished: str
    changed_since: Sequence[str]
    made_of: Sequence[str]

    @property
    def error(self) -> float:
        """Its final error, infinite where it failed."""
        return math.inf if self.mse is None else self.mse


def _calibration(paths: ProjectPaths, manifest_file: Path) -> Calibration | None:
    name, label = manifest_file.stem.removeprefix("calibrate-"), manifest_file.parent.name
    manifest = read_json(manifest_file)
    numbers = read_json(manifest_file.with_name(f"calibration-{name}.json"))
    if manifest is None or numbers is None:
        return None
    try:
        return _read(paths, f"{label}/{name}", manifest, numbers)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        where = paths.show(manifest_file)
        raise InputError(f"{where}: holds no calibration that this version can read; move it away") from None


def _read(
    paths: ProjectPaths, name: str, manifest: Mapping[str, Any], numbers: Mapping[str, Any]
) -> Calibration:
    """Take what a record, maybe a stranger's, says into values of their types; any error if it cannot."""
    recipe, declared = numbers.get("recipe", {}), dict[str, Any]()
    with suppress(KeyError, TypeError, InputError):
        declared = parse_toml(recipe["case"]["text"], name)
    outputs, theta = declared.get("outputs", ()), {k: float(v) for k, v in numbers["theta"].items()}
    if not all(map(math.isfinite, theta.values())):
        raise ValueError("a calibrated parameter is a finite number")
    label, mse = name.partition("/")[0], numbers.get("mse_polished", numbers.get("mse"))
    return Calibration(
        case=str(declared.get("name", label)),
        label=label,
        name=name,
        mse=None if mse is None or not math.isfinite(mse) else float(mse),
        unit=squared(difference_unit(outputs[0]["unit"])) if outputs else "",
        n_calls_paper=int(numbers["ledger"]["total_paper"]),
        n_calls_all=int(numbers["ledger"]["total_honest"]),
        n_known=int(numbers.get("n_known", 0)),
        theta=theta,
        units={str(one["name"]): str(one.get("unit", "1")) for one in declared.get("parameters", ())},
        reason=str(numbers.get("polish_stop_reason", numbers.get("stop_reason", ""))),
        finished=str(manifest.get("finished", "")),
        changed_since=_changed(paths, recipe),
        made_of=(str(numbers.get("case_sha256")), str(numbers.get("measurement_sha256"))),
    )


def _changed(paths: ProjectPaths, recipe: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a recipe that hold something else now."""
    changed = []
    for one in (recipe["case"], *recipe["files"]) if recipe else ():
        with suppress(OSError):
            file = paths.located(one["place"])
            changed += [file.name] if file is not None and file_digest(file) != one["sha256"] else []
    return list(dict.fromkeys(changed))


@dataclass(frozen=True)
class Project:
    """The studies and calibrations of a project.

    Args:
        paths: where everything lies.
        studies: its Optuna studies.
        calibrations: its finished calibrations.
    """

    paths: ProjectPaths
    studies: Sequence[TunedStudy]
    calibrations: Sequence[Calibration]

    @property
    def sizes(self) -> list[TunedSize]:
        """What each study came to."""
        return [one.summary(self.studies) for one in self.studies]


def read_project(paths: ProjectPaths, which: str | None = None) -> Project:
    """Read what a project holds.

    Args:
        paths: the project.
        which: a case, a label or a pattern of labels; None for everything.

    Raises:
        InputError: nothing is called so.
    """
    files = sorted((paths.mlruns / "results").glob("*/calibrate-*.json"))
    calibrations = [one for file in files if (one := _calibration(paths, file)) is not None]
    studies = read_studies(paths)
    if which is None:
        return Project(paths, studies, calibrations)
    cases = {one.spec.label: one.spec.case_name for one in studies}
    cases |= {one.label: one.case for one in calibrations}
    labels = {label for label, case in cases.items() if fnmatchcase(label, which) or case == which}
    if not labels:
        raise InputError(f"nothing is called {which!r}; labels: {', '.join(sorted(cases)) or 'none'}")
    studies = [one for one in studies if one.spec.label in labels]
    return Project(paths, studies, [one for one in calibrations if one.label in labels])
