"""What a project holds: its Optuna studies and its finished calibrations, and what changed since."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.provenance import file_digest
from studies.report.records_tuning import TunedSize
from studies.report.wording import quantity, square_of
from studies.stages.pipeline import Outcome, read_outcome
from studies.stages.saved import plain
from studies.stages.stage_results import Calibration
from studies.tuning.study_results import TunedStudy, read_studies

FIRST_WORDS = "type: studies run (the office, some minutes), or studies new for a case of your own"


@dataclass(frozen=True)
class FinishedCalibration:
    """A finished calibration of a project.

    Args:
        label: label of its study.
        outcome: what it came to.
        changed_since: files that it was made from and that hold something else now.
    """

    label: str
    outcome: Outcome[Calibration]
    changed_since: Sequence[str]

    @property
    def found(self) -> Calibration:
        """Its result."""
        return self.outcome.result

    @property
    def name(self) -> str:
        """What it is called on a command line."""
        return f"{self.label}/{self.outcome.name}"

    @property
    def mse_text(self) -> str:
        """Its error with the unit; "failed" where the last simulation failed."""
        if not math.isfinite(self.found.mse):
            return "failed"
        return quantity(self.found.mse, square_of(self.found.output_unit), 4)

    def to_dict(self) -> dict[str, Any]:
        """Return what programs read."""
        about = {"label": self.label, "name": self.name, "finished": self.outcome.finished}
        return {**about, "changed_since": list(self.changed_since), **plain(self.found)}


def _changed(paths: ProjectPaths, files: object) -> list[str]:
    """Return the names of recorded files that hold something else now."""
    changed = []
    for place, sha256 in files.items() if isinstance(files, dict) else ():
        with suppress(OSError):
            file = paths.located(place)
            changed += [file.name] if file is not None and file_digest(file) != sha256 else []
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
    calibrations: Sequence[FinishedCalibration]

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
    outcomes = [(file.parent.name, read_outcome(file.parent, file.stem, Calibration)) for file in files]
    calibrations = [
        FinishedCalibration(label, one, _changed(paths, one.provenance.get("files")))
        for label, one in outcomes
        if one is not None
    ]
    studies = read_studies(paths)
    if which is None:
        return Project(paths, studies, calibrations)
    cases = {one.spec.label: one.spec.case_name for one in studies}
    cases |= {one.label: one.found.case for one in calibrations}
    labels = {label for label, case in cases.items() if fnmatchcase(label, which) or case == which}
    if not labels:
        raise InputError(f"nothing is called {which!r}; labels: {', '.join(sorted(cases)) or 'none'}")
    studies = [one for one in studies if one.spec.label in labels]
    return Project(paths, studies, [one for one in calibrations if one.label in labels])
