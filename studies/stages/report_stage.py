"""The last stage: everything that lies on disk on one page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.time_unit import period_text
from studies.provenance import file_digest
from studies.report import Provenance, ReportData, build
from studies.stages.finished import stored_calibrations, stored_indices, stored_uncertainties
from studies.stages.pipeline import Outcome, Stage, Study
from studies.stages.report_records import coverage_set, uncertainty_record
from studies.stages.shown import report_of
from studies.stages.stage_results import Reported
from studies.stages.stage_runs import log_report
from studies.stages.tuned_trials import trials_record, tuned_by_size, tuned_sizes
from studies.tracking.origin import versions


def report_stage(study: Study) -> Outcome[Reported]:
    """Put all stored results of the label on one page.

    Raises:
        InputError: there is no calibration to report.
    """
    if not any(stored_calibrations(study)):
        raise InputError(
            f"{study.label} has no calibration to report; type: studies calibrate {study.command}"
        )
    folder = study.paths.report(study.label)
    inputs = {
        "case": study.case.digest,
        "title": study.case.title,
        "note": study.case.note,
        "references": [vars(known) for known in study.case.references],
        "parameters": [vars(parameter) for parameter in study.case.parameter_space.parameters],
        "results": {file.name: file_digest(file) for file in _source_files(study)},
        "trials": [
            [one.spec.name, [(trial.number, trial.state, trial.value) for trial in one.trials]]
            for baseline in (False, True)
            for one in tuned_by_size(study, baseline=baseline).values()
        ],
        "versions": versions(),
    }

    index = folder / "index.html"
    stage = Stage(study, "report", f"tables and figures of {study.label}", inputs, Reported)
    before = stage.finished()
    if before is not None:
        return before
    with stage.work() as work:
        build(_report_data(study), folder)
        study.console.say(f"report: {study.paths.show(index)} is written; now into MLflow")
        found = Reported(study.paths.recorded(index))
        return work.keep(found, [index], log=log_report)


def show_report(study: Study, found: Reported) -> None:
    """Say where the report lies."""
    study.console.result(f"Report: {study.paths.root / found.index}")


def _report_data(study: Study) -> ReportData:
    tuned = tuned_by_size(study)
    return report_of(
        study,
        list(stored_calibrations(study)),
        coverage=coverage_set(study),
        sensitivity=stored_indices(study),
        uncertainties=tuple(uncertainty_record(stored.result) for stored in stored_uncertainties(study)),
        tuned=tuned_sizes(study),
        trials=trials_record(tuned),
        provenance=_provenance(study),
    )


def _provenance(study: Study) -> Provenance:
    case, stored = study.case, list(stored_calibrations(study))
    commands = dict.fromkeys(str(one.provenance["command"]) for one in stored)
    settings = {
        "window": period_text(case.window_d),
        "communication step": f"{case.communication_step_s:g} s",
    }
    settings |= _flat(study.profile.to_dict())
    for one in stored:
        settings |= _flat(one.result.settings, f"{one.name}.")
    return Provenance(
        commands=(*commands, f"studies ui  # {study.label} in MLflow"),
        settings=tuple(settings.items()),
        digests=(
            ("case", case.digest),
            ("FMU", case.fmu.sha256),
            ("measurement", case.measurement.digest),
        ),
        versions=tuple(versions().items()),
    )


def _flat(settings: Mapping[str, Any], before: str = "") -> dict[str, str]:
    """Return nested settings by dotted names, those without a value left out."""
    found: dict[str, str] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{before}{name}.")
        elif value not in (None, "", (), []):
            found[f"{before}{name}"] = str(value)
    return found


def _source_files(study: Study) -> list[Path]:
    stages = ["simulate", "sensitivity", *(one.stage for one in stored_calibrations(study))]
    stages += [one.stage for one in stored_uncertainties(study)]
    files = [study.results / f"{stage}.json" for stage in stages]
    return [file for file in files if file.is_file()]
