"""Do all stages in order and skip finished ones.

What happens: check, simulate, tune, sensitivity, calibrate (every size), report. Optuna tunes the latent
dimension, the width of the hidden layers and beta of a PELS-VAE for each training-set size. A finished
stage is skipped; an interrupted stage goes on where it stopped. The report is
mlruns/reports/<label>/index.html.

With --simulations N the whole run takes at most N simulations. Training sets grow from about one row per
parameter on, until two lead to the same error or N is spent. Surrogates are judged by cross-validation, Sobol
indices are those of the last one, and no check is made before: `studies check` has its own simulations.

Examples:
  studies run                              the office, quick profile
  studies run --dry-run                    the plan and known durations
  studies run office-recorded --seed 3
  studies run office --n-train 32 64 --trials 12
  studies run my-case --simulations 100    all of it within 100 simulations, for a model that is expensive
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import FAILED, document, foretold, keywords_of
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    *options.TUNING,
    *options.calls("most FMU calls of one polish; default: the profile's"),
    options.FMU,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api import chain
    from studies.api.judgements import UnsoundError
    from studies.doctor import show_diagnosis
    from studies.stages.learn import show_tuning
    from studies.stages.report_stage import show_report
    from studies.stages.shown import show_calibrations

    try:
        result = chain.run(**keywords_of(chosen, console))
    except UnsoundError as error:
        task, checked = error.checked.task, error.checked.outcome
        show_diagnosis(console, task.label, checked.result)
        console.document({"command": "run", "label": task.label, "stages": [checked.to_dict(task.paths)]})
        return FAILED
    task, stages = result.task, result.stages
    show_tuning(task, result.tuning.tuned)
    show_calibrations(task, [one.outcome for one in result.calibrations])
    show_report(task, stages[-1].result)
    if result.spent is None:
        return document(task, "run", stages)
    spent = {"budget": result.spent.budget, "used": result.spent.used, "ended": result.spent.ended}
    return document(task, "run", stages, simulations=spent)
