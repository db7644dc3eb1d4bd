"""The last stage: everything that lies on disk on one page."""

from simulation.arrays import FloatArray
from simulation.errors import InputError
from studies.provenance import file_digest
from studies.report.page import ReportData, write_page
from studies.row_set import RowSet
from studies.sobol import SobolIndices
from studies.stages.finished import stored, stored_calibrations, stored_uncertainties
from studies.stages.pipeline import Outcome, Stage, Study
from studies.stages.stage_results import Reported, SimulatedSets
from studies.stages.stage_runs import log_report
from studies.stages.tuned_trials import trials_record, tuned_by_size
from studies.tracking.origin import versions

N_COVERAGE = 256
"""Trajectories drawn of the training set, as in the paper's Fig. 4."""


def report_stage(study: Study) -> Outcome[Reported]:
    """Put all stored results of the label on one page.

    Raises:
        InputError: there is no calibration to report.
    """
    calibrations, uncertainties = tuple(stored_calibrations(study)), tuple(stored_uncertainties(study))
    if not calibrations:
        raise InputError(
            f"{study.label} has no calibration to report; type: studies calibrate {study.command}"
        )
    tuned, baselines = (tuned_by_size(study, baseline=is_baseline) for is_baseline in (False, True))
    stages = ["simulate", "sensitivity", *(one.stage for one in (*calibrations, *uncertainties))]
    files = [study.results / f"{stage}.json" for stage in stages]
    inputs = {
        "case": [study.case.digest, file_digest(study.case.path)],
        "results": {file.name: file_digest(file) for file in files if file.is_file()},
        "trials": [
            [one.spec.name, [(trial.number, trial.state, trial.value) for trial in one.trials]]
            for one in (*tuned.values(), *baselines.values())
        ],
        "versions": versions(),
    }

    index = study.paths.report(study.label) / "index.html"
    stage = Stage(study, "report", f"tables and figures of {study.label}", inputs, Reported)

    def write() -> Reported:
        data = ReportData(
            study.label,
            study.case,
            calibrations,
            coverage=_coverage(study),
            sensitivity=stored(study, "sensitivity", SobolIndices),
            tuned=tuple(one.summary(baselines.values()) for one in tuned.values() if one.best is not None),
            trials=trials_record(tuned),
            uncertainties=tuple(one.result for one in uncertainties),
            commands=tuple(dict.fromkeys(str(one.provenance["command"]) for one in calibrations)),
        )
        write_page(data, index)
        study.console.say(f"report: {study.paths.show(index)} is written; now into MLflow")
        return Reported(study.paths.recorded(index))

    return stage.once(write, files=[index], log=log_report)


def show_report(study: Study, found: Reported) -> None:
    """Say where the report lies."""
    study.console.result(f"Report: {study.paths.root / found.index}")


def _coverage(study: Study) -> FloatArray | None:
    """Return the first rows of the training design, None where nothing was simulated. Shape (n, t, k)."""
    sets = stored(study, "simulate", SimulatedSets)
    if sets is None:
        return None
    file = study.paths.root / sets.files["train"]
    return RowSet.load(file).read(N_COVERAGE).y if file.is_file() else None
