"""Estimate first- and total-order Sobol indices per time step.

What happens: the command asks the best surrogate of the label for Saltelli's sample, which simulates nothing.
With --fmu it simulates the sample on the FMU. It estimates the indices at every output step, with 95 %
confidence intervals. They are bootstrapped; those of a surrogate also hold its own error. Results:
mlruns/results/<label>/sensitivity.json and .npz. The table shows averages over time.

Examples:
  studies sensitivity                            after `studies run` or `studies tune`
  studies sensitivity --fmu                      n_base (p + 2) simulations; n_base is the profile's
  studies sensitivity office --window 8-16 --json
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, foretold, keywords_of
from studies.words.console import Console

OPTIONS = (*options.SIMULATED, options.FMU, options.DRY_RUN)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api.chain import sensitivity
    from studies.reporting.tables import sensitivity_table

    result = sensitivity(**keywords_of(chosen, console))
    found = result.outcome.result
    console.show([sensitivity_table(found)])
    mean = {name: {"first": first, "total": total} for name, (first, total) in found.mean.items()}
    return document(result.task, "sensitivity", [result.outcome], mean_indices=mean)
