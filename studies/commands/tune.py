"""`studies tune`: tune one surrogate per training-set size."""

import argparse

from studies.commands import options
from studies.commands.study import foretell, hand_over, open_study
from studies.console import Console

HELP = "tune one surrogate per training-set size with Optuna"
MORE = """\
what happens: one Optuna study per training-set size, in mlruns/optuna.db. Each trial trains a PELS-VAE; the
profile's search space says which hyperparameters Optuna chooses: by default the latent dimension (n_latent),
the width of the hidden layers (n_hidden) and beta. Each trial is an MLflow run that can be watched while it
trains. The best one of each size is registered in MLflow. PCA + GP is fitted once per size for comparison.

Optuna owns the trials: what you enqueue or add with Optuna is kept and counted, and optuna-dashboard shows
them. Interrupted or killed, the same command goes on; more --trials extend a study.

examples:
  studies tune                             all sizes of the profile
  studies tune --n-train 32 128 --trials 40
  studies tune --dry-run                   what would be done
  studies tune --parallel 4 --max-hours 8  four trials of a size side by side, over night
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)
    options.add_simulation(command)
    options.add_tuning(command)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.learn import require_tuning, show_tuning, tune_stage
    from studies.stages.simulate import simulate_stage

    study = open_study(chosen, console)
    if chosen.dry_run:
        return foretell(study, "tune", whole=False)
    require_tuning(study)
    simulated = simulate_stage(study)
    tuned = tune_stage(study, simulated)
    show_tuning(study, tuned)
    return hand_over(study, "tune", [simulated, tuned])
