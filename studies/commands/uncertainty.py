"""Show how sure a calibration is: intervals, equally good parameter sets, bands.

What happens: the command differentiates the residuals at the calibrated point, with two calls per
parameter. So it finds which parameters the data determine, which compensate each other, and linearised
intervals. Then it draws equally good parameter sets from a Gaussian process of the residuals. The process
is fitted to all stored simulations near the optimum. The FMU simulates a sample of these sets, which are
reweighted by the result. Their 5 to 95 % bands are shown with the measurement. If the calibration learnt
state equations, these replace the FMU, which then simulates only the sample. If the FMU disagrees with
them, the command begins again with the FMU alone. Each simulation is stored at once: after an interruption,
the same command goes on. Results: mlruns/results/<label>/uncertainty-<calibration>.json and .npz, a run in
MLflow, a page by studies report.

--profiles adds the profile likelihood of each parameter: the least error that each of its values leaves,
with the others at their best. It is followed by the state equations, else by a Gaussian process of the
simulations, and the FMU is simulated at the ends of the intervals. A ridge shows as a profile that stays
within up to a bound. Results: profiles-<calibration>.json and .npz.

--noise is the model of the residuals:
  correlated  their size is estimated, and they are autocorrelated: many samples count as few (default)
  white       their size is estimated, and they are independent
  sensor      the uncertainty that the case file declares

Examples:
  studies uncertainty                         of the adaptive calibration, else of the best other one
  studies uncertainty --method paper --n-train 64
  studies uncertainty --noise sensor --max-calls 200
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, foretold, keywords_of
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    *options.CALIBRATION,
    options.Option(
        "--noise",
        default="correlated",
        help="model of the residuals; default: correlated",
    ),
    *options.calls("most FMU calls; default: 20 per parameter, at least 100"),
    options.Option(
        "--profiles",
        action="store_true",
        help="follow the profile likelihood of each parameter too: 2 more FMU calls for each, and one",
    ),
    options.MAX_HOURS,
    options.DRY_RUN,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api.judgements import uncertainty
    from studies.stages.shown import show_profiles, show_uncertainty

    result = uncertainty(**keywords_of(chosen, console))
    show_uncertainty(result.task, result.outcome.result)
    if result.profiled is None:
        return document(result.task, "uncertainty", [result.outcome])
    show_profiles(result.task, result.profiled.result, result.outcome.result)
    return document(result.task, "uncertainty", [result.outcome, result.profiled])
