"""A measured value that is wrong is named: before a calibration by `check`, after it by its result."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from records_for_tests import calibration

from simulation.case import load_case
from studies.doctor.declared import look_at_data
from studies.reporting.sentences import calibration_sentences
from studies.stages.calibrated_point import fits

ROOT = Path(__file__).parents[2]


def recorded(folder: Path, row: int, off: float) -> tuple[Path, str]:
    """Copy the wall with one measured value off by so many K; return its folder and the value's time."""
    for part in ("fmus", "data"):
        shutil.copytree(ROOT / part / "wall", folder / part / "wall", dirs_exist_ok=True)
    file = folder / "data" / "wall" / "measured.csv"
    table = pandas.read_csv(file)
    table.loc[row, "TMasonry_degC"] += off
    table.to_csv(file, index=False)
    return folder / "fmus" / "wall", f"time_s = {table.time_s[row]}"


@pytest.mark.parametrize("seed", range(10))
def test_a_wrong_sample_is_named_with_the_time_of_the_file(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    row = int(rng.integers(2, 100))
    folder, at = recorded(tmp_path, row, 25.0)
    case = load_case(folder)
    (far,) = (one.found for one in look_at_data(case) if one.what == "values far from all others")
    assert far.startswith("TMasonry: ")
    assert f"at {at.removeprefix('time_s = ')} s; the others" in far
    # What the model answers is off as a fit is, everywhere but there.
    right = load_case(recorded(tmp_path, row, 0.0)[0])
    y = np.stack(
        [np.interp(case.measurement.time, one.samples.time, one.samples.values) for one in right.outputs], 1
    )
    y += np.array([0.05, 2.0]) * rng.standard_normal(y.shape)
    found = fits(case, y)
    largest = found["TMasonry"].largest
    assert largest is not None
    assert largest.at == at
    assert largest.difference == pytest.approx(-25.0, abs=0.5)
    assert largest.times_median is not None
    assert largest.times_median > 100.0
    result = replace(calibration(), outputs=found, y=y, determined_by_data=None)
    (said,) = (one for one in calibration_sentences(case, result) if "differs most" in one)
    assert said.startswith(f"TMasonry differs most at {at}, by 2")
    assert said.endswith('empty its cell, or let it count less with loss = "huber" for this output')
    assert all(fit.largest is None for fit in fits(right, y).values())


def test_what_no_sensor_sees_is_no_wrong_sample(tmp_path: Path) -> None:
    folder, _ = recorded(tmp_path, 50, 0.04)
    case, right = load_case(folder), load_case(recorded(tmp_path, 50, 0.0)[0])
    y = np.stack(
        [np.interp(case.measurement.time, one.samples.time, one.samples.values) for one in right.outputs], 1
    )
    assert fits(case, y)["TMasonry"].largest is None
