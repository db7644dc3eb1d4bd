"""Finished calibrations of a study and their uncertainties, as they lie in the results folder."""

from collections.abc import Iterator

import numpy as np

from studies.sobol import SobolIndices
from studies.stages.knowledge import is_current
from studies.stages.pipeline import Outcome, Study, read_outcome
from studies.stages.stage_results import Calibration, Uncertainty


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


def stored_indices(study: Study) -> SobolIndices | None:
    """Return the Sobol indices of this case, None where there are none."""
    found = read_outcome(study.results, "sensitivity", SobolIndices)
    return None if found is None or found.inputs["case"] != study.case.digest else found.result
