"""What each command does: put a study together, run its stages, show or hand over the results."""

import argparse
import shlex
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from simulation.errors import InputError
from studies.console import Column, Console
from studies.paths import find_case, find_project
from studies.pipeline import Outcome, Study
from studies.profile import load_profile

OK, FAILED = 0, 1


def _new(options: argparse.Namespace, console: Console) -> int:
    from studies.cli_new import list_variables, new_case

    return (list_variables if options.list else new_case)(options, find_project(), console)


def _check(options: argparse.Namespace, console: Console) -> int:
    from studies.doctor import show_diagnosis
    from studies.stages_check import diagnose

    study = open_study(options, console)
    diagnosis = diagnose(study, is_thorough=options.thorough)
    show_diagnosis(console, study.label, diagnosis)
    console.document({"command": "check", "label": study.label, **diagnosis.to_dict()})
    return OK if diagnosis.is_sound else FAILED


def _simulate(options: argparse.Namespace, console: Console) -> int:
    from studies.stages_simulate import show_sets, simulate_stage

    study = open_study(options, console)
    outcome = simulate_stage(study)
    show_sets(study, outcome)
    return _hand_over(study, "simulate", [outcome])


def _sensitivity(options: argparse.Namespace, console: Console) -> int:
    from studies.stages_simulate import sensitivity_stage, show_sensitivity

    study = open_study(options, console)
    outcome = sensitivity_stage(study)
    show_sensitivity(study, outcome)
    return _hand_over(study, "sensitivity", [outcome])


def _tune(options: argparse.Namespace, console: Console) -> int:
    from studies.stages_learn import show_tuning, tune_stage
    from studies.stages_simulate import simulate_stage

    study = open_study(options, console)
    simulated = simulate_stage(study)
    tuned = tune_stage(study, simulated)
    show_tuning(study, tuned)
    return _hand_over(study, "tune", [simulated, tuned])


def _calibrate(options: argparse.Namespace, console: Console) -> int:
    if options.method == "adaptive":
        return _calibrate_adaptively(options, console)
    if options.parallel is not None:
        raise InputError("--parallel belongs to --method adaptive; add that or leave --parallel away")
    from studies.calibrated_values import show_values
    from studies.stages_calibrate import calibrate_stage, calls_to, show_calibrations, sizes_with_champion

    study = open_study(options, console)
    sizes = sizes_with_champion(study, options.n_train)
    outcomes = [calibrate_stage(study, n_train, again=options.again) for n_train in sizes]
    show_calibrations(study, outcomes, options.target)
    show_values(study, outcomes)
    extra: dict[str, Any] = {}
    if options.target is not None:
        extra = {
            "target": options.target,
            "calls_to_target": {n: calls_to(study, n, options.target) for n in sizes},
        }
    return _hand_over(study, "calibrate", outcomes, **extra)


def _calibrate_adaptively(options: argparse.Namespace, console: Console) -> int:
    if options.n_train:
        raise InputError(
            "--n-train belongs to --method paper; the adaptive one has no training set, leave it away"
        )
    from studies.stages_adaptive import adaptive_settings, adaptive_stage, calls_to, show_adaptive

    study = open_study(options, console)
    settings = adaptive_settings(
        study.case, max_calls=options.max_calls, n_parallel=options.parallel, target_mse=options.target
    )
    outcome = adaptive_stage(study, settings, again=options.again)
    show_adaptive(study, outcome)
    targets = {known.mse for known in study.case.references if known.is_target} | {options.target} - {None}
    return _hand_over(
        study,
        "calibrate",
        [outcome],
        method="adaptive",
        calls_to_target={f"{target:g}": calls_to(study, target) for target in sorted(targets)},
    )


def _report(options: argparse.Namespace, console: Console) -> int:
    from studies.stages_report import report_stage, show_report

    study = open_study(options, console)
    outcome = report_stage(study)
    show_report(study, outcome)
    return _hand_over(study, "report", [outcome])


def _run(options: argparse.Namespace, console: Console) -> int:
    from studies.calibrated_values import show_values
    from studies.doctor import say_warnings, show_diagnosis
    from studies.stages_calibrate import calibrate_stage, show_calibrations
    from studies.stages_check import check_stage
    from studies.stages_learn import show_tuning, tune_stage
    from studies.stages_report import report_stage, show_report
    from studies.stages_simulate import sensitivity_stage, simulate_stage

    study = open_study(options, console)
    checked, diagnosis = check_stage(study)
    if not diagnosis.is_sound:
        show_diagnosis(console, study.label, diagnosis)
        console.document({"command": "run", "label": study.label, "stages": [checked.to_dict()]})
        return FAILED
    say_warnings(console, diagnosis)
    simulated = simulate_stage(study)
    sensitivity = sensitivity_stage(study)
    tuned = tune_stage(study, simulated)
    calibrated = [
        calibrate_stage(study, n_train, again=options.again) for n_train in study.profile.data.n_train
    ]
    reported = report_stage(study)
    show_tuning(study, tuned)
    show_calibrations(study, calibrated, options.target)
    show_values(study, calibrated)
    show_report(study, reported)
    return _hand_over(study, "run", [checked, simulated, sensitivity, tuned, *calibrated, reported])


def _ui(options: argparse.Namespace, console: Console) -> int:
    from studies.cli_ui import open_ui

    return open_ui(find_project(), console, port=options.port, dry_run=options.dry_run)


def _import_recording(options: argparse.Namespace, console: Console) -> int:
    from pathlib import Path

    from studies.recording import import_recording

    paths = find_project()
    report = import_recording(
        [Path(file).expanduser() for file in options.files], paths.data / "office-recorded"
    )
    files = [paths.show(file) for file in report.files]
    console.table(
        f"imported from {report.source}",
        [Column("file"), Column("rows", True)],
        list(zip(files, report.n_rows, strict=True)),
    )
    if report.kelvin:
        console.result(f"converted from kelvin: {', '.join(report.kelvin)}")
    console.result(f"{report.duration_d:.2f} days; calibrate against them: studies run office-recorded")
    console.document(
        {
            "command": "import-recording",
            "source": report.source,
            "files": files,
            "n_rows": report.n_rows,
            "duration_d": report.duration_d,
            "converted_from_kelvin": report.kelvin,
        }
    )
    return OK


COMMANDS: dict[str, Callable[[argparse.Namespace, Console], int]] = {
    "new": _new,
    "check": _check,
    "simulate": _simulate,
    "sensitivity": _sensitivity,
    "tune": _tune,
    "calibrate": _calibrate,
    "report": _report,
    "ui": _ui,
    "import-recording": _import_recording,
    "run": _run,
}


def open_study(options: argparse.Namespace, console: Console) -> Study:
    """Put together case, profile and the options that change them.

    Raises:
        InputError: any of them is wrong.
    """
    paths = find_project()
    profile = load_profile(options.profile)
    label_end = ""
    if options.window is not None:
        label_end += f"-{options.window.label}"
    if options.seed is not None and options.seed != profile.seed:
        label_end += f"-seed{options.seed}"
        profile = replace(profile, seed=options.seed)
    given = vars(options)
    if given.get("n_train") and options.command != "calibrate":
        profile = replace(profile, data=replace(profile.data, n_train=tuple(sorted(set(given["n_train"])))))
    if given.get("trials"):
        profile = replace(profile, tuning=replace(profile.tuning, n_trials=given["trials"]))
    if given.get("max_calls"):
        profile = replace(profile, polish=replace(profile.polish, max_calls=given["max_calls"]))
    file = find_case(paths, options.case)
    # Heavy imports wait until the words of the command line are known to be good.
    from simulation.case import load_case
    from simulation.workers.parallel import available_cores

    case = load_case(file, window_d=None if options.window is None else options.window.days)
    return Study(
        case=case,
        profile=profile,
        paths=paths,
        console=console,
        n_jobs=options.jobs or available_cores(),
        label=f"{case.name}-{profile.name}{label_end}",
        command=_command(options),
        retry_failed=given.get("retry_failed", False),
        dask=given.get("dask"),
    )


def _command(options: argparse.Namespace) -> str:
    """Return the words that name this study on a command line."""
    words = [options.case]
    if options.profile != "quick":
        words += ["--profile", options.profile]
    if options.window is not None:
        words += ["--window", str(options.window)]
    if options.seed is not None:
        words += ["--seed", str(options.seed)]
    return shlex.join(words)


def _hand_over(study: Study, command: str, outcomes: list[Outcome], **extra: Any) -> int:
    study.console.document(
        {
            "command": command,
            "case": study.case.name,
            "profile": study.profile.name,
            "label": study.label,
            "note": study.case.note,
            "stages": [outcome.to_dict() for outcome in outcomes],
            **extra,
        }
    )
    return OK
