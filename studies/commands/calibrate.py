"""Find the parameters that fit the measurement best.

What happens: the command needs the case alone: no training set and no initial guess. A small design fills
the box of the parameters. Each further simulation is placed where the lowest error is expected. This
prediction comes from the model's state equations or from a Gaussian process of all residuals so far. The
search stops when it expects little gain, at the latest after --max-calls. With --target it goes on until
the error is at most MSE, the budget is used up, or no lower error is expected. Each simulation is stored at
once: after an interruption or a kill, the same command reads the stored ones and goes on. --parallel Q runs
Q simulations per round, spread over --jobs: fewer rounds, but more calls. Results:
mlruns/results/<label>/calibrate-adaptive.json and .npz, a run in MLflow, a page by studies report.

It begins with the simulations that studies check made of this model, which cost no call; the result gives
their number. --no-from-stored begins with none. --from-stored begins with all stored simulations of this
model, at most 250. They may come from training sets or from an earlier calibration, also with other data,
weights, priors or bounds. After such a change the optimum is often found in one to three calls. With --again
the calibration begins with everything that is stored by now.

State equations describe how the states of the FMU change. They are learnt from the states and derivatives
that the FMU returns in each simulation. They are found where the derivatives are sums of states, inputs,
their products and simple functions. Examples are resistances and capacities, flows times temperatures,
radiation, reactions and tanks. Then a calibration mostly takes five to ten simulations, with 4 parameters
or with 14. Where no equations are found, the search uses the outputs alone and says so.
--no-state-equations always uses the outputs alone. --state-equations requires states and says why those of
an FMU cannot be read.

--n-train 64 uses the method of the paper with the surrogate of 64 simulations; --method paper uses it for
all tuned sizes. Differential evolution searches the whole box on the surrogate. One FMU call checks the
point that it finds; the difference of the errors is the screening gap. From there a search on the FMU
polishes, which the surrogate leads. Results: calibrate-n<size>.json and .npz.

Both methods use the priors of the parameters (case.toml: prior = { about = 0.7, within_factor = 1.5 }).

Examples:
  studies calibrate                        the office, 100 FMU calls at most
  studies calibrate my-case --max-calls 60 --parallel 4 --jobs 4
  studies calibrate my-case --target 0.0121 --json
  studies calibrate my-case --from-stored  after a change of data, weights, priors or bounds: a few calls
  studies calibrate --n-train 64           from the surrogate that was trained with 64 simulations
  studies calibrate --n-train 64 --again   repeat it: the same numbers
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, foretold, keywords_of
from studies.commands.options import Option
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    Option(
        "--method",
        help="adaptive (default): fewest FMU calls, no training set; "
        "paper (default with --n-train): screen on the surrogate, polish on the FMU",
    ),
    Option(
        "--parallel",
        metavar="Q",
        help="adaptive: simulations per round; default: 1",
    ),
    Option(
        "--from-stored",
        action=argparse.BooleanOptionalAction,
        help="adaptive: begin with the stored simulations of this model or with none; default: with those of "
        "studies check",
    ),
    Option(
        "--state-equations",
        action=argparse.BooleanOptionalAction,
        help="adaptive: learn state equations or not; default: yes if the FMU gives its states",
    ),
    Option("--target", metavar="MSE", help="adaptive: go on until this error"),
    options.sizes("paper: training-set sizes; default: all that have a surrogate"),
    *options.calls("most FMU calls, of all (adaptive; default: 100) or of one polish (paper; the profile's)"),
    options.MAX_HOURS,
    options.DRY_RUN,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api.calibrations import calibrate
    from studies.stages.shown import show_calibrations

    result = calibrate(**keywords_of(chosen, console))
    task = result.task
    show_calibrations(task, result.stages)
    if not result.outcome.result.is_adaptive:
        return document(task, "calibrate", result.stages)
    targets = {known.mse for known in task.case.references if known.is_target} | {chosen.target} - {None}
    calls = {f"{target:g}": result.outcome.result.history.calls_to(target) for target in sorted(targets)}
    return document(task, "calibrate", result.stages, method="adaptive", calls_to_target=calls)
