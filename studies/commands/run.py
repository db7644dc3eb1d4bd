"""Do all stages in order and skip finished ones.

What happens: check, simulate, sensitivity, tune, calibrate (every size), report. Optuna tunes the latent
dimension, the width of the hidden layers and beta of a PELS-VAE for each training-set size. A finished
stage is skipped; an interrupted stage goes on where it stopped. The report is
mlruns/reports/<label>/index.html.

Examples:
  studies run                              the office, quick profile
  studies run --dry-run                    the plan and known durations
  studies run office-recorded --seed 3
  studies run office --n-train 32 64 --trials 12
"""

import argparse

from studies.commands import options
from studies.commands.task import FAILED, OK, hand_over, open_task
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    *options.TUNING,
    *options.calls("most FMU calls of one polish; default: the profile's"),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    task = open_task(chosen, console)
    if chosen.dry_run:
        from studies.forecast import foretell

        foretell(task, "run")
        return OK
    from studies.doctor import say_warnings, show_diagnosis
    from studies.stages.calibrate_stage import calibrate_stage
    from studies.stages.check_stage import check_stage
    from studies.stages.learn import require_tuning, show_tuning, tune_stage
    from studies.stages.report_stage import report_stage, show_report
    from studies.stages.shown import show_calibrations
    from studies.stages.simulate_stage import sensitivity_stage, simulate_stage

    require_tuning(task)
    checked = check_stage(task)
    diagnosis = checked.result
    if not diagnosis.is_sound:
        show_diagnosis(console, task.label, diagnosis)
        document = {"command": "run", "label": task.label, "stages": [checked.to_dict(task.paths)]}
        console.document(document, of=(task, [checked]))
        return FAILED
    say_warnings(console, diagnosis)
    simulated = simulate_stage(task)
    sensitivity = sensitivity_stage(task)
    tuned = tune_stage(task, simulated)
    calibrated = [calibrate_stage(task, n_train, again=chosen.again) for n_train in task.profile.data.n_train]
    reported = report_stage(task)
    show_tuning(task, tuned.result)
    show_calibrations(task, calibrated)
    show_report(task, reported.result)
    return hand_over(task, "run", [checked, simulated, sensitivity, tuned, *calibrated, reported])
