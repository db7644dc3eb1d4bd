"""`studies uncertainty`: say how sure a calibration is."""

import argparse

from studies.commands import options, values
from studies.commands.study import hand_over, open_study
from studies.console import Console

HELP = "show how sure a calibration is: intervals, equally good parameter sets, bands"
MORE = """\
what happens: the command differentiates the residuals at the calibrated point, with two calls per
parameter. So it finds which parameters the data determine, which compensate each other, and linearised
intervals. Then it draws equally good parameter sets from a Gaussian process of the residuals. The process
is fitted to all stored simulations near the optimum. The FMU simulates a sample of these sets, which are
reweighted by the result. Their 5 to 95 % bands are shown with the measurement. If the calibration learnt
state equations, these replace the FMU, which then simulates only the sample. If the FMU disagrees with
them, the command begins again with the FMU alone. Each simulation is stored at once: after an interruption,
the same command goes on. Results: mlruns/results/<label>/posterior-<calibration>.json and .npz, a run in
MLflow, a page by studies report.

--noise is the model of the residuals:
  correlated  their size is estimated, and they are autocorrelated: many samples count as few (default)
  white       their size is estimated, and they are independent
  sensor      the uncertainty that the case file declares

--most-relevant 6 treats the calibration that calibrated six parameters and fixed the others. Intervals,
sample and bands are those of the six. They hold only if the fixed values are right, because the uncertainty
of these is not included. The result names the fixed parameters and their values. Its files end in
-relevant6.

examples:
  studies uncertainty                         of the adaptive calibration, else of the best other one
  studies uncertainty --method paper --n-train 64
  studies uncertainty my-case --most-relevant 6
  studies uncertainty --noise sensor --max-calls 200
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)
    options.add_simulation(command)
    command.add_argument(
        "--method",
        choices=("paper", "adaptive"),
        help="method of the calibration; default: adaptive if there is one",
    )
    options.add_sizes(command, "the calibration with this training-set size; default: the best")
    options.add_most_relevant(
        command, "the calibration of the K most relevant parameters; the fixed values are taken as right"
    )
    command.add_argument(
        "--noise",
        choices=("correlated", "white", "sensor"),
        default="correlated",
        help="model of the residuals; default: correlated",
    )
    command.add_argument(
        "--max-calls",
        type=values.whole(1),
        metavar="N",
        help="most FMU calls; default: 20 per calibrated parameter, at least 100",
    )
    command.add_argument("--again", action="store_true", help="repeat a finished estimate")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.restriction import checked_size
    from studies.stages.uncertainty import UncertaintySettings, uncertainty_stage, usual_calls
    from studies.stages.uncertainty_results import calibration_to_judge
    from studies.stages.uncertainty_shown import show_uncertainty

    study = open_study(chosen, console)
    n_free = None if chosen.most_relevant is None else checked_size(study.case, chosen.most_relevant)
    calibration = calibration_to_judge(study, chosen.method, chosen.n_train, n_free)
    max_calls = chosen.max_calls or usual_calls(n_free or study.case.parameter_space.n_parameters)
    settings = UncertaintySettings(noise=chosen.noise, max_calls=max_calls)
    outcome = uncertainty_stage(study, calibration, settings, again=chosen.again)
    show_uncertainty(study, outcome)
    return hand_over(study, "uncertainty", [outcome])
