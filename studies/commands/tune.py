"""Tune one surrogate per training-set size with Optuna.

What happens: each training-set size has one Optuna study in mlruns/optuna.db. Each trial trains a PELS-VAE.
The search space of the profile says which hyperparameters Optuna chooses. By default these are the latent
dimension (n_latent), the width of the hidden layers (n_hidden) and beta. Each trial is an MLflow run that
shows its curves during training. The best trial of each size is registered in MLflow. PCA + GP is fitted
once per size for comparison.

Optuna owns the trials. Trials that you enqueue or add with Optuna are kept and counted; optuna-dashboard
shows them. After an interruption or a kill, the same command goes on. More --trials extend a study.

Examples:
  studies tune                             all sizes of the profile
  studies tune --n-train 32 128 --trials 40
  studies tune --dry-run                   the plan
  studies tune --parallel 4 --max-hours 8  four trials of a size at the same time, overnight
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, foretold, keywords_of
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    *options.TUNING,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api.chain import tune
    from studies.stages.learn import show_tuning

    result = tune(**keywords_of(chosen, console))
    show_tuning(result.task, result.tuned)
    return document(result.task, "tune", result.stages)
