"""What lies in the results folder of a label: finished calibrations and uncertainties, of one case file."""

from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np

from simulation.errors import InputError
from simulation.foreign_file import CASE, parse_toml, read_text
from studies.stages.knowledge import is_current
from studies.stages.pipeline import Outcome, Study, read_json, read_outcome
from studies.stages.stage_results import Calibration, Uncertainty

T = TypeVar("T")


def stored_calibrations(study: Study) -> Iterator[Outcome[Calibration]]:
    """Read all calibrations of this case and measurement, the adaptive first, then by training set."""
    for file in sorted(study.results.glob("calibrate-*.json")):
        found = read_outcome(study.results, file.stem, Calibration)
        if found is not None and is_current(found.inputs, study.case):
            yield found


def stored_uncertainties(study: Study) -> Iterator[Outcome[Uncertainty]]:
    """Read what is known of the stored calibrations' uncertainty."""
    for calibration in stored_calibrations(study):
        found = read_outcome(study.results, f"uncertainty-{calibration.name}", Uncertainty)
        is_of_it = found is not None and np.array_equal(found.result.point, calibration.result.point)
        if found is not None and is_of_it and is_current(found.inputs, study.case):
            yield found


def stored(study: Study, stage: str, kind: type[T]) -> T | None:
    """Return the stored result of a stage of this case, with any measurement; None where there is none.

    Args:
        study: the study.
        stage: name of the stage.
        kind: type of its result.
    """
    found = read_outcome(study.results, stage, kind)
    return None if found is None or found.inputs["case"] != study.case.digest else found.result


def refuse_other_case(study: Study) -> None:
    """Refuse a study whose label holds results of another case file that still has this case's name.

    The same file edited in place is no other one, wherever the project was moved: what lies in the project is
    recorded by its place below the root. A file that is gone or was renamed has given its name away.

    Raises:
        InputError: there is such a file.
    """
    case, paths = study.case, study.paths
    for manifest in sorted(study.results.glob("*.json")):
        recorded = (read_json(manifest) or {}).get("case_file")
        other = paths.located(recorded)
        if other is None or other.resolve() == case.path.resolve() or _name_in(other) != case.name:
            continue
        raise InputError(
            f'{paths.show(case.path)}: name = "{case.name}" is also that of {paths.show(other)}, whose '
            f"results {paths.show(study.results)} holds; give one of the two another name, or move that "
            "folder away"
        )


def _name_in(file: Path) -> str | None:
    """Return the name that a case file declares, None where there is none."""
    try:
        name = parse_toml(read_text(file, CASE), str(file)).get("name")
    except InputError:
        return None
    return name if isinstance(name, str) else None
