"""The last stage: everything that lies on disk on one page."""

import hashlib
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.time_unit import period_text
from studies.profile import Profile, changed_words
from studies.report import Provenance, ReportData, build
from studies.report.uncertainty import uncertainty_record
from studies.report.wording import count
from studies.stages.adaptive import adaptive_command
from studies.stages.pipeline import (
    Outcome,
    Study,
    Summary,
    digest_of,
    read_manifest,
    run_stage,
    write_json,
)
from studies.stages.results import (
    ADAPTIVE,
    calibration_record,
    coverage_set,
    measured_series,
    n_free_of,
    stored_calibrations,
    stored_indices,
    validation_record,
)
from studies.stages.tracking import log_report
from studies.stages.tuned_trials import trials_record, tuned_by_size, tuned_sizes
from studies.stages.uncertainty_results import stored_posteriors
from studies.tracking.origin import versions


def report_stage(study: Study) -> Outcome:
    """Put all stored results of the label on one page.

    Raises:
        InputError: there is no calibration to report.
    """
    if not any(True for _ in stored_calibrations(study)):
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
        "results": {file.name: _sha256(file) for file in _source_files(study)},
        "trials": [
            [one.spec.name, [(trial.number, trial.state, trial.value) for trial in one.trials]]
            for baseline in (False, True)
            for one in tuned_by_size(study, baseline=baseline).values()
        ],
        "versions": versions(),
    }

    drawn, index, digest = folder / "drawn.json", folder / "index.html", digest_of(inputs)

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        # Where logging to MLflow failed, the command is typed again: what is drawn is not drawn once more.
        if read_manifest(study.paths, drawn, digest) is None:
            drawn.unlink(missing_ok=True)
            with study.console.progress("tables and figures", 1) as advance:
                build(_report_data(study), folder, on_progress=advance)
            files = [file for file in folder.iterdir() if file.is_file()]
            sizes = {study.paths.relative(file): file.stat().st_size for file in files}
            write_json(drawn, {"digest": digest, "files": sizes})
        study.console.say(f"report: {study.paths.show(index)} is written; now into MLflow")
        log_report(
            study.paths,
            study.label,
            digest,
            case={"case": study.case.name, "case_sha256": study.case.digest},
            note=study.case.note,
            index=index,
            started_s=started_s,
            wall_s=time.time() - started_s,
        )
        drawn.unlink(missing_ok=True)
        summary = {"index": study.paths.recorded(index), "n_files": sum(1 for _ in folder.iterdir())}
        return summary, [index]

    return run_stage(
        study,
        "report",
        what=f"tables and figures of {study.label}",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{study.paths.show(index)} is up to date",
    )


def show_report(study: Study, outcome: Outcome) -> None:
    """Say where the report lies."""
    study.console.result(f"Report: {study.paths.root / outcome.summary['index']}")


def _report_data(study: Study) -> ReportData:
    case, tuned = study.case, tuned_by_size(study)
    return ReportData(
        label=study.label,
        title=case.title,
        note=case.note,
        measurement=measured_series(case),
        parameters=case.parameter_space,
        calibrations=tuple(calibration_record(stored) for stored in stored_calibrations(study)),
        coverage=coverage_set(study),
        sensitivity=stored_indices(study),
        validations=tuple(
            record
            for stored in stored_calibrations(study)
            if (record := validation_record(case, stored)) is not None
        ),
        uncertainties=tuple(
            uncertainty_record(stored.numbers, stored.arrays) for stored in stored_posteriors(study)
        ),
        tuned=tuned_sizes(study),
        trials=trials_record(tuned),
        references=case.references,
        provenance=_provenance(study),
    )


def _provenance(study: Study) -> Provenance:
    profile, case = study.profile, study.case
    stored = list(stored_calibrations(study))
    commands = dict.fromkeys(command_of(study, one.numbers) for one in stored)
    has_surrogates = any(not one.is_adaptive for one in stored)
    return Provenance(
        commands=(*commands, f"studies ui  # {study.label} in MLflow"),
        settings=(
            ("profile", profile.name),
            ("seed", str(profile.seed)),
            ("window", period_text(case.window_d)),
            ("communication step", f"{case.communication_step_s:g} s"),
            *(_surrogate_settings(profile) if has_surrogates else ()),
            *((one.name, _adaptive_settings(one.numbers["settings"])) for one in stored if one.is_adaptive),
        ),
        digests=(
            ("case", case.digest),
            ("FMU", case.fmu.sha256),
            ("measurement", case.measurement.digest),
        ),
        versions=tuple(versions().items()),
    )


def _surrogate_settings(profile: Profile) -> tuple[tuple[str, str], ...]:
    data, budget = profile.data, profile.tuning
    return (
        ("training-set sizes", ", ".join(map(str, data.n_train))),
        ("validation and test", f"{data.n_validation} and {data.n_test} simulations"),
        ("tuning", f"{count(budget.n_trials, 'trial')} per size, surrogate {budget.surrogate}"),
        ("screening", ", ".join(f"{name} {value}" for name, value in asdict(profile.screening).items())),
        ("polish", f"at most {count(profile.polish.max_calls, 'call')}, ftol {profile.polish.ftol:g}"),
    )


def command_of(study: Study, found: Mapping[str, Any]) -> str:
    """Return the command line that makes a calibration again, with its surrogates where it has any."""
    if found.get("method") == ADAPTIVE:
        return adaptive_command(study, found)
    recipe = found.get("recipe", {})
    if n_free_of(found) is not None and recipe:
        return str(recipe["command"])
    own = study.own_profile or study.profile
    return f"studies run {study.command}{changed_words(own, recipe.get('profile', {}))}"


def _adaptive_settings(settings: dict[str, Any]) -> str:
    n_parallel, ftol = settings["n_parallel"], settings["ftol"]
    return f"at most {count(settings['max_calls'], 'call')}, {n_parallel} at a time, ftol {ftol:g}"


def _source_files(study: Study) -> list[Path]:
    files = [file for stored in stored_calibrations(study) for file in (stored.files.numbers,)]
    files += [stored.files.numbers for stored in stored_posteriors(study)]
    files += [study.results / name for name in ("simulate.json", "sensitivity.json")]
    return [file for file in files if file.is_file()]


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
