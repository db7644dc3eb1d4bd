"""The last stage: everything that lies on disk on one page."""

from simulation.arrays import FloatArray
from simulation.errors import InputError
from studies.calibration.sobol import SobolIndices
from studies.reporting.page import ReportData, write_page
from studies.results.outcome import Outcome
from studies.results.provenance import file_digest
from studies.results.row_set import RowSet
from studies.results.stage_results import Reported, SimulatedSets
from studies.results.trials import TunedStudy
from studies.stages.finished import (
    stored,
    stored_calibrations,
    stored_choices,
    stored_profiles,
    stored_uncertainties,
)
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_report
from studies.stages.tuned_trials import trials_record, tuned_by_size
from studies.task import Task
from studies.tracking.origin import versions
from studies.tuning.study_results import importances

N_COVERAGE = 256
"""Trajectories drawn of the training set, as in the paper's Fig. 4."""


def report_stage(task: Task) -> Outcome[Reported]:
    """Put all stored results of the label on one page.

    Raises:
        InputError: there is no calibration to report.
    """
    calibrations, uncertainties = tuple(stored_calibrations(task)), tuple(stored_uncertainties(task))
    if not calibrations:
        raise InputError(f"{task.label} has no calibration to report; type: studies calibrate {task.command}")
    tuned, baselines = (tuned_by_size(task, baseline=is_baseline) for is_baseline in (False, True))
    choices, profiles = tuple(stored_choices(task)), tuple(stored_profiles(task, uncertainties))
    judged = *calibrations, *uncertainties, *choices, *profiles
    stages = ["simulate", "sensitivity", *(one.stage for one in judged)]
    files = [task.results / f"{stage}.json" for stage in stages]
    inputs = {
        "case": [task.case.digest, file_digest(task.case.path)],
        "results": {file.name: file_digest(file) for file in files if file.is_file()},
        "trials": [
            [one.spec.name, [(trial.number, trial.state, trial.value) for trial in one.trials], _run_of(one)]
            for one in (*tuned.values(), *baselines.values())
        ],
        "versions": versions(),
    }

    index = task.paths.report(task.label) / "index.html"
    stage = Stage(task, "report", f"tables and figures of {task.label}", inputs, Reported)

    def write() -> Reported:
        data = ReportData(
            task.label,
            task.case,
            calibrations,
            coverage=_coverage(task),
            sensitivity=stored(task, "sensitivity", SobolIndices),
            tuned=tuple(one.summary(baselines.values()) for one in tuned.values() if one.best is not None),
            trials=trials_record(tuned),
            studies=tuple(tuned.values()),
            importances={n: _importances(one) for n, one in tuned.items()},
            uncertainties=tuple(one.result for one in uncertainties),
            profiles=tuple(one.result for one in profiles),
            choices=tuple(one.result for one in choices),
            commands=tuple(dict.fromkeys(str(one.provenance["command"]) for one in calibrations)),
        )
        write_page(data, index)
        task.console.say(f"report: {task.paths.show(index)} is written; now into MLflow")
        return Reported(task.paths.recorded(index))

    return stage.once(write, files=[index], log=log_report)


def show_report(task: Task, found: Reported) -> None:
    """Say where the report lies."""
    task.console.result(f"Report: {task.paths.root / found.index}")


def _importances(study: TunedStudy) -> dict[str, float]:
    """Return the part of each hyperparameter in what decides the validation error. [1]."""
    judged = [one for one in study.trials if one.value is not None and one.params]
    values = [one.value for one in judged if one.value is not None]
    return importances([one.params for one in judged], values, study.spec.space)


def _coverage(task: Task) -> FloatArray | None:
    """Return the first rows of the training design, None where nothing was simulated. Shape (n, t, k)."""
    sets = stored(task, "simulate", SimulatedSets)
    if sets is None:
        return None
    file = task.paths.root / sets.files["train"]
    return RowSet.load(file).read(N_COVERAGE).y if file.is_file() else None


def _run_of(tuned: TunedStudy) -> str:
    """Return the run of the best surrogate, which may change though no trial does."""
    return "" if tuned.best is None else tuned.best.run_id
