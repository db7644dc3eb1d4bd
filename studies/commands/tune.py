"""`studies tune`: tune one surrogate per training-set size."""

import argparse

from studies.commands import options
from studies.commands.study import foretell, hand_over, open_study
from studies.console import Console

HELP = "tune one surrogate per training-set size"
MORE = """\
what happens: one Optuna study per size in mlruns/optuna.journal; each trial trains a PELS-VAE and
becomes an MLflow run with its learning curves and errors in kelvin. The best of each size lands in
mlruns/champions/<label>/ and in the MLflow registry. A resumed study equals an uninterrupted one; more
--trials extend it.

examples:
  studies tune                             all sizes of the profile
  studies tune --n-train 32 128 --trials 20
  studies tune --dry-run                   what would run, and how long it takes
  studies tune --parallel 4 --max-hours 8  four trials of a size at once, over night
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)
    options.add_simulation(command)
    options.add_tuning(command)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.learn import show_tuning, tune_stage
    from studies.stages.simulate import simulate_stage

    study = open_study(chosen, console)
    if chosen.dry_run:
        return foretell(study, "tune", whole=False)
    simulated = simulate_stage(study)
    tuned = tune_stage(study, simulated)
    show_tuning(study, tuned)
    return hand_over(study, "tune", [simulated, tuned])
