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
from studies.commands.task import OK, hand_over, open_task
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    *options.TUNING,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    task = open_task(chosen, console)
    if chosen.dry_run:
        from studies.forecast import foretell

        foretell(task, "tune")
        return OK
    from studies.stages.learn import require_tuning, show_tuning, tune_stage
    from studies.stages.simulate_stage import simulate_stage

    require_tuning(task)
    simulated = simulate_stage(task)
    tuned = tune_stage(task, simulated)
    show_tuning(task, tuned.result)
    return hand_over(task, "tune", [simulated, tuned])
