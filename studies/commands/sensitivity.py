"""Estimate first- and total-order Sobol indices per time step.

What happens: the command simulates Saltelli's sample on the FMU. It estimates the indices with bootstrapped
confidence intervals at every output step. Results:
mlruns/results/<label>/sensitivity.json and .npz. The table shows averages over time.

Examples:
  studies sensitivity
  studies sensitivity office --window 8-16 --json
"""

import argparse

from studies.commands import options
from studies.commands.task import hand_over, open_task
from studies.words.console import Console

OPTIONS = options.SIMULATED


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.reporting.tables import sensitivity_table
    from studies.stages.simulate_stage import sensitivity_stage

    task = open_task(chosen, console)
    outcome = sensitivity_stage(task)
    console.show([sensitivity_table(outcome.result)])
    mean = {name: {"first": first, "total": total} for name, (first, total) in outcome.result.mean.items()}
    return hand_over(task, "sensitivity", [outcome], mean_indices=mean)
