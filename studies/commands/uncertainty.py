"""`studies uncertainty`: say how sure a calibration is."""

import argparse

from studies.commands import options, values
from studies.commands.study import hand_over, open_study
from studies.console import Console

HELP = "say how sure a calibration is: intervals, equally good parameter sets, bands"
MORE = """\
what happens: the residuals are differentiated at the calibrated point (two calls per parameter): which
parameters the data determine, which compensate each other, linearised intervals. Then equally good parameter
sets are drawn: particles on a Gaussian process of the residuals, which all stored simulations near the
optimum teach; the FMU simulates a sample of it and reweights it. Their 5 to 95 % bands are shown over the
measurement. Where the calibration learnt state equations, these answer in the FMU's place, and it simulates
the sample alone; if it disagrees, all begins again with the FMU. Every simulation is stored at once:
interrupted, the same command goes on. Lands in mlruns/results/<label>/posterior-<calibration>.json and .npz,
in MLflow and, with studies report, on a page.

--noise says what residuals are: correlated (default: as large as they are, and following each other, so that
many samples are worth few), white (as large as they are, all independent), sensor (the declared uncertainty).

--most-relevant 6 judges the calibration that calibrated six parameters and fixed the others: intervals,
sample and bands of the six. They hold only if the fixed ones are right, for what is not known about these is
not in them; the result names these and their values. Lands in ...-relevant6, beside that of all parameters.

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
        "--method", choices=("paper", "adaptive"), help="whose calibration; default: adaptive if there is one"
    )
    options.add_sizes(command, "the calibration with this training-set size; default: the best")
    options.add_most_relevant(
        command, "the calibration of the K most relevant parameters, the fixed ones taken as right"
    )
    command.add_argument(
        "--noise",
        choices=("correlated", "white", "sensor"),
        default="correlated",
        help="what residuals are; default: correlated",
    )
    command.add_argument(
        "--max-calls",
        type=values.whole(1),
        metavar="N",
        help="most FMU calls; default: 20 per calibrated parameter, at least 100",
    )
    command.add_argument("--again", action="store_true", help="do it once more though it is finished")


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
