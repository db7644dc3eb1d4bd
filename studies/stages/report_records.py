"""Results of the stages as the records that the report draws."""

from dataclasses import replace

import numpy as np

from simulation.case import Case
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.uncertainty_record import UncertaintyRecord
from studies.report.validation import ValidationRecord
from studies.row_set import RowSet
from studies.stages.pipeline import Outcome, Study, read_outcome
from studies.stages.saved import plain
from studies.stages.stage_results import Calibration, SimulatedSets, Uncertainty

N_COVERAGE = 256
"""Trajectories drawn of the training set, as in the paper's Fig. 4."""


def measured_series(case: Case) -> MeasuredSeries:
    """Return what the case is calibrated against."""
    return MeasuredSeries(case.measurement, tuple(output.unit for output in case.outputs))


def calibration_record(outcome: Outcome[Calibration]) -> CalibrationRecord:
    """Return a calibration as a record; an adaptive one has no training set and no screened point."""
    found, ledger, screened = outcome.result, outcome.result.ledger, outcome.result.screening
    errors = {} if screened is None else screened.errors
    held = {} if found.prior is None else found.prior.parameters
    known = {
        name: f"prior {one.in_words}, moved by {one.moved_deviations:+.2f} of it"
        for name, one in held.items()
    }
    nowhere = np.full_like(found.y, np.nan)
    return CalibrationRecord(
        n_train=found.n_train,
        theta_screened=np.array(
            [np.nan if screened is None else screened.theta[name] for name in found.theta]
        ),
        theta_polished=found.point,
        mse_surrogate=np.nan if screened is None else screened.mse_surrogate,
        mse_screened=np.nan if screened is None else screened.mse,
        mse_polished=found.mse,
        y_screened=nowhere if found.y_screened is None else found.y_screened,
        y_polished=found.y,
        history_calls=found.history_calls,
        history_mse=found.history_mse,
        n_validation=ledger["n_validation"],
        n_test=ledger["n_test"],
        n_screen_checks=ledger["n_screen_checks"],
        n_polish=ledger["n_polish"],
        n_adaptive=ledger["n_adaptive"],
        wall_s=outcome.wall_s,
        test_mae=errors.get("test/mae", np.nan),
        test_p90=errors.get("test/p90", np.nan),
        stop_reason=found.stop_reason,
        method=found.method,
        n_known=found.n_warm_start or 0,
        knowledge=tuple(known.get(name, "") for name in found.theta) if known else (),
        state_equations="" if found.state_equations is None else found.state_equations.sentence,
        left_open=() if found.determined_by_data is None else found.determined_by_data.sentences,
    )


def validation_record(case: Case, found: Calibration) -> ValidationRecord | None:
    """Return a calibration on the validation period, None where the case has none."""
    if case.validation is None or found.validation is None or found.validation_y is None:
        return None
    y = found.validation_y
    screened = found.validation_y_screened
    return ValidationRecord(
        n_train=found.n_train,
        period_d=case.validation.window_d,
        measurement=replace(measured_series(case), measurement=case.validation.measurement.from_first_sample),
        y_screened=np.full_like(y, np.nan) if screened is None else screened,
        y_polished=y,
        points=found.validation.points,
    )


def uncertainty_record(found: Uncertainty) -> UncertaintyRecord:
    """Return an uncertainty as a record; without a sample to rely on it has no intervals and no pairs."""
    is_trusted, every = found.sample.is_trusted, list(found.parameters.values())
    interval = np.array([one.interval for one in every]).T
    return UncertaintyRecord(
        calibration=found.calibration,
        level=found.level,
        noise=plain(found.noise),
        names=tuple(found.parameters),
        calibrated=found.point,
        linear=np.array([one.linear for one in every]).T,
        interval=interval if is_trusted else np.full_like(interval, np.nan),
        known=tuple(one.known if is_trusted else "unsure" for one in every),
        pairs=tuple(pair.in_words for pair in found.pairs if is_trusted),
        null_directions=found.null_directions,
        particles=found.particles_theta,
        weights=found.weights,
        simulated=found.simulated,
        predictive=found.predictive,
        n_effective=found.sample.n_effective,
        is_trusted=is_trusted,
        mse=found.mse,
        best_mse=found.sample.best_mse,
        has_prior=found.has_prior,
        sensor=np.inf if found.sensor is None else found.sensor,
        # The report speaks of what was known before.
        ledger={**plain(found.ledger), "n_known": found.ledger.n_warm_start},
    )


def coverage_set(study: Study) -> CoverageSet | None:
    """Return the first rows of the training design, None where nothing was simulated."""
    outcome = read_outcome(study.results, "simulate", SimulatedSets)
    if outcome is None or outcome.inputs["case"] != study.case.digest:
        return None
    file = study.paths.root / outcome.result.files["train"]
    return CoverageSet("training", RowSet.load(file).read(N_COVERAGE).y) if file.is_file() else None
