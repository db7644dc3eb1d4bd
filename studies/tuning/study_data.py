"""The data sets of a study, checked before a trial is spent on them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation.errors import InputError
from simulation.store.row_set import RowSet
from studies.tuning.study_spec import StudySpec

_Pair = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class StudyData:
    """The data sets of a study without their failed rows: pairs of theta (n, p) and y (n, t, k)."""

    train: _Pair
    validation: _Pair
    test: _Pair


def load_data(spec: StudySpec) -> StudyData:
    """Read a study's data sets and leave out failed simulations.

    Raises:
        InputError: a file does not hold what the study was declared with, or no good row is left.
    """
    sets = [
        (spec.train_file, spec.n_train, spec.train_digest),
        (spec.validation_file, None, spec.validation_digest),
        (spec.test_file, None, spec.test_digest),
    ]
    pairs = []
    for file, n, digest in sets:
        rows = RowSet.load(file).read(n)
        if rows.digest != digest:
            raise InputError(f"{file} has changed since the study was set up; start the command again")
        good = rows.take(~rows.failed)
        if good.n < 2:
            raise InputError(
                f"{file} has {good.n} good simulations of {rows.n}; a surrogate needs at least 2"
            )
        pairs.append((good.theta, good.y))
    return StudyData(*pairs)
