"""What lies in the results folder of a label: finished calibrations and uncertainties, of one case file."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from simulation.errors import InputError
from simulation.foreign_file import CASE, parse_toml, read_text
from studies.results.choice import Choice
from studies.results.outcome import Outcome, read_manifest, read_outcome
from studies.results.profiled import Profiles
from studies.results.stage_results import Calibration, Uncertainty
from studies.stages.knowledge import is_current
from studies.task import Task

T = TypeVar("T")


def stored_calibrations(task: Task) -> Iterator[Outcome[Calibration]]:
    """Read all calibrations of this case and measurement, the adaptive first, then by training set."""
    for file in sorted(task.results.glob("calibrate-*.json")):
        found = read_outcome(task.results, file.stem, Calibration)
        if found is not None and is_current(found.inputs, task.case):
            yield found


def stored_uncertainties(task: Task) -> Iterator[Outcome[Uncertainty]]:
    """Read what is known of the stored calibrations' uncertainty."""
    for calibration in stored_calibrations(task):
        found = read_outcome(task.results, f"uncertainty-{calibration.name}", Uncertainty)
        is_of_it = found is not None and np.array_equal(found.result.point, calibration.result.point)
        if found is not None and is_of_it and is_current(found.inputs, task.case):
            yield found


def stored_profiles(task: Task, uncertainties: Sequence[Outcome[Uncertainty]]) -> Iterator[Outcome[Profiles]]:
    """Read the profile likelihoods that belong to uncertainties as they are."""
    for one in uncertainties:
        found = read_outcome(task.results, f"profiles-{one.result.calibration}", Profiles)
        if found is not None and found.inputs["uncertainty"] == one.digest:
            yield found


def stored_choices(task: Task) -> Iterator[Outcome[Choice]]:
    """Read the comparisons of this structure with others, as long as its measurement is the same."""
    for file in sorted(task.results.glob("choose-*.json")):
        found = read_outcome(task.results, file.stem, Choice)
        if found is not None and is_current(found.inputs["structures"][0], task.case):
            yield found


def stored(task: Task, stage: str, kind: type[T]) -> T | None:
    """Return the stored result of a stage of this case, with any measurement; None where there is none.

    Args:
        task: the task.
        stage: name of the stage.
        kind: type of its result.
    """
    found = read_outcome(task.results, stage, kind)
    return None if found is None or found.inputs["case"] != task.case.digest else found.result


def refuse_other_case(task: Task) -> None:
    """Refuse a study whose label holds results of another case file that still has this case's name.

    The same file edited in place is no other one, wherever the project was moved: what lies in the project is
    recorded by its place below the root. A file that is gone or was renamed has given its name away.

    Raises:
        InputError: there is such a file.
    """
    case, paths = task.case, task.paths
    for manifest in sorted(task.results.glob("*.json")):
        recorded = (read_manifest(task.results, manifest.stem) or {}).get("case_file")
        other = paths.located(recorded)
        if other is None or other.resolve() == case.path.resolve() or _name_in(other) != case.name:
            continue
        raise InputError(
            f'two case files have the name "{case.name}": {paths.show(case.path)} and {paths.show(other)}, '
            f"whose results are in {paths.show(task.results)}; rename one case, or move that folder away"
        )


def _name_in(file: Path) -> str | None:
    """Return the name that a case file declares, None where there is none."""
    try:
        name = parse_toml(read_text(file, CASE), str(file)).get("name")
    except InputError:
        return None
    return name if isinstance(name, str) else None
