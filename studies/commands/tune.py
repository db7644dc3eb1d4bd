"""Tune one surrogate per training-set size with Optuna.

What happens: each training-set size has one Optuna study in mlruns/optuna.db. Each trial trains a PELS-VAE.
The search space of the profile says which hyperparameters Optuna chooses. By default these are the latent
dimension (n_latent), the width of the hidden layers (n_hidden) and beta. Each trial is an MLflow run that
shows its curves during training. The best trial of each size is registered in MLflow. PCA + GP is fitted
once per size for comparison.

Optuna owns the trials. Trials that you enqueue or add with Optuna are kept and counted; optuna-dashboard
shows them. After an interruption or a kill, the same command goes on. More --trials extend a study.

With --objective the trials call a function of yours: objective(trial) returns a number, or several. They
have all that trials of surrogates have. The function is named here alone, never in a profile.

Examples:
  studies tune                             all sizes of the profile
  studies tune --n-train 32 128 --trials 40
  studies tune --dry-run                   the plan
  studies tune --parallel 4 --max-hours 8  four trials of a size at the same time, overnight
  studies tune --objective mine:error --trials 50
  studies tune --objective mine:error --values mae seconds --profile my.toml
"""

import argparse

from simulation.errors import InputError
from studies.commands import options
from studies.commands.hand_over import OK, document, foretold, keywords_of
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    options.OBJECTIVE,
    options.Option("--name", metavar="NAME", help="its study; default: the name of the function"),
    options.Option("--values", nargs="+", metavar="NAME", help="what it returns; default: value"),
    options.Option("--maximize", nargs="+", metavar="NAME", help="those that are maximized; default: none"),
    *options.TUNING,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.objective is not None:
        return _objective(chosen, console)
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api.chain import TuningResult, tune
    from studies.stages.learn import show_tuning

    result = tune(**keywords_of(chosen, console))
    assert isinstance(result, TuningResult), "of a case"
    show_tuning(result.task, result.tuned)
    return document(result.task, "tune", result.stages)


def _objective(chosen: argparse.Namespace, console: Console) -> int:
    """Tune with a user's function, which modules of the working folder may hold."""
    if chosen.dry_run:
        raise InputError("--dry-run is of a case, and an objective has none; leave out one of the two")
    options.find_modules(chosen)
    from studies.api.chain import tune
    from studies.api.objectives import ObjectiveResult
    from studies.reporting.tables_objective import best_blocks_of

    result = tune(**keywords_of(chosen, console))
    assert isinstance(result, ObjectiveResult), "of an objective"
    console.show(best_blocks_of(result.tuned, result.paths.optuna_url))
    console.document({"command": "tune", **result.tuned.to_dict()})
    return OK
