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
from studies.commands.task import hand_over, open_task
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    *options.CALIBRATION,
    options.Option(
        "--noise",
        choices=("correlated", "white", "sensor"),
        default="correlated",
        help="model of the residuals; default: correlated",
    ),
    *options.calls("most FMU calls; default: 20 per parameter, at least 100"),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.shown import show_uncertainty
    from studies.stages.uncertainty_stage import calibration_to_judge, uncertainty_stage, usual_calls

    task = open_task(chosen, console)
    calibration = calibration_to_judge(task, chosen.method, chosen.n_train)
    max_calls = chosen.max_calls or usual_calls(task.case.parameter_space.n_parameters)
    outcome = uncertainty_stage(
        task, calibration, noise=chosen.noise, max_calls=max_calls, again=chosen.again
    )
    show_uncertainty(task, outcome.result)
    return hand_over(task, "uncertainty", [outcome])
