"""Validation on days that the calibration did not see: what it simulates, compares and leaves alone."""

import json
from pathlib import Path

import numpy as np
import pytest

from simulation.case import load_case
from simulation.counting import CountingModel
from studies.stages.calibrated_point import validate


def test_points_are_compared_on_both_periods(whole_run: Path) -> None:
    case = load_case(whole_run / "fmus" / "office")
    assert case.validation is not None
    middle = case.parameter_space.from_unit(np.full((2, 14), 0.5))
    middle[1, 0] = np.nan
    with case.validation.open_model() as model, case.open_model() as short:
        counted = CountingModel(model)
        validation, simulated = validate(case, counted, {"middle": middle[0], "nothing": middle[1]})
        answer, window = model.simulate(middle[:1]), short.simulate(middle[:1])
    assert counted.n_calls == 2
    point = validation.points["middle"]
    assert point.mse_window == case.measurement.mse(window.y)[0]
    # The half hours after day 10 until day 12, against the plain formula.
    measured = case.validation.measurement.outputs[0].samples
    assert measured.time[[0, -1]].tolist() == [10 * 86400 + 1800, 12 * 86400]
    difference = answer.y[0, -96:, 0] - measured.values
    assert point.mse == pytest.approx(np.mean(difference**2), rel=1e-12)
    fit = point.outputs["TAir"]
    assert (fit.n_samples, fit.rmse**2) == (96, pytest.approx(point.mse, rel=1e-12))
    assert fit.bias == pytest.approx(np.mean(difference), rel=1e-12)
    # Degrees Celsius have no mean to be a share of.
    assert fit.cv_rmse is None
    assert fit.nmbe is None
    failed = validation.points["nothing"]
    assert (failed.mse, failed.mse_window, failed.outputs) == (None, None, {})
    assert failed.failure
    assert simulated.y[0].tolist() == answer.y[0].tolist()


def test_a_whole_run_validates_and_counts_it_nowhere(whole_run: Path) -> None:
    # The first output's sensor failed for a day.
    assert load_case(whole_run / "fmus" / "office").measurement.n_samples == 481 - 48
    file = whole_run / "mlruns" / "results" / "office-smoke" / "calibrate-n0032.json"
    calibration = json.loads(file.read_text())["result"]
    points = calibration["validation"]["points"]
    assert list(points) == ["estimate", "screened", "polished"]
    assert points["polished"]["mse_window"] == calibration["mse"]
    assert points["screened"]["mse_window"] == calibration["screening"]["mse"]
    assert points["polished"]["outputs"]["TAir"]["n_samples"] == 96
    ledger = calibration["ledger"]
    assert ledger["total_calls"] == sum(ledger[name] for name in ledger if name.startswith("n_"))
    report = whole_run / "mlruns" / "reports" / "office-smoke"
    page = (report / "index.html").read_text()
    assert "<h3>The part that was not calibrated: MSE" in page
    assert "Validation on days 10 to 12, which the calibration did not see" in page
    assert "No count of calls includes its simulations" in page
