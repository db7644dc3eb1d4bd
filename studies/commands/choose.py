"""Compare model structures on the same measurement.

Each structure is a case of its own, with its own FMU and parameters, and the same measurement: samples,
window, uncertainties and weights.

What happens: the command calibrates what is not calibrated yet, as studies calibrate does, mostly with five
to ten simulations where state equations hold. Then it judges all structures with one noise model, that of
the structure of least error. It shows AIC, BIC, the Bayesian evidence over bounds and priors, and the error
on experiments or parts of the time that a calibration did not see. It says whether the residuals are white.
Of a structure whose parameters another one has too, it shows the likelihood ratio of the two. All this takes
state equations and no simulation; else a Gaussian process and two simulations per parameter.

It recommends a structure whose probability is at least 75 % and whose BIC is the least, or whose probability
is at least 95 %. If another one predicts left-out parts clearly better, or neither holds, it says that the
data do not decide. Structures count as equally probable before, and parameters as equally probable within
their bounds.

Results: mlruns/results/<label of the first case>/choose-<other cases>.json, a run in MLflow with one below
it for each structure, a part of the page by studies report.

Examples:
  studies choose one-room two-rooms three-rooms
  studies choose small large --window 0-7 --noise sensor
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, keywords_of
from studies.words.console import Console

OPTIONS = (
    options.Option("cases", nargs="+", metavar="CASE", help="names, files or folders of two or more cases"),
    *(one for one in options.CASE if one.names[0] not in ("case", "--simulations", "--surrogate")),
    *options.SIMULATION,
    options.Option("--noise", default="correlated", help="model of the residuals; default: correlated"),
    *options.calls("most FMU calls of each calibration; default: 100"),
    options.MAX_HOURS,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.planning import choose
    from studies.stages.shown import show_choice

    result = choose(**keywords_of(chosen, console))
    show_choice(result.task, result.outcome.result)
    return document(result.task, "choose", [result.outcome])
