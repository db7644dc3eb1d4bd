"""`studies calibrate`: find the parameters that fit best."""

import argparse

from simulation.errors import InputError
from studies.commands import options, values
from studies.commands.study import hand_over, open_study
from studies.console import Console

HELP = "find the parameters that fit best"
MORE = """\
what happens: a small design fills the box; then every simulation goes where the lowest error is expected
(--method adaptive), by the model's state equations or by a Gaussian process of all residuals so far. It
needs the case alone: no training set, no initial guess. It stops when little gain is expected, at the latest
after --max-calls; with --target only at that error or then, or where state equations know no lower one. Every
simulation is stored at once: interrupted, even killed, the same command reads them and goes on. --parallel Q
asks Q rows per round (fewer rounds, more calls), spread over --jobs. Lands in
mlruns/results/<label>/calibration-adaptive.json and .npz, in MLflow and, with studies report, on a page.

--from-stored begins with what is stored of this model, 250 simulations at most, whatever they were made for:
training sets, an earlier calibration, other data, weights, priors or bounds. They cost nothing, and after
such a change the optimum is often found in one to three calls. The result says how many they were. With
--again it begins with what has been stored since.

State equations say how the FMU's states move, and not only what its sensors would show. They are learnt from
the states and derivatives that an FMU answers in every simulation. Where these are sums of states, inputs,
products of these and simple functions (resistances and capacities, flows times temperatures, radiation,
reactions, tanks) a calibration mostly takes five to ten simulations, of 14 parameters as of 4; where they are
not, the search goes on without, and says so. --no-state-equations does without in any case; --state-equations
says why an FMU's states cannot be read.

--n-train 64, or --method paper for all sizes that are tuned, is the paper's way: differential evolution
searches the whole box on the surrogate of the size's best trial; the FMU is asked at the found point (the
screening gap) and polished from there by LS-TRF. Lands in calibration-n<size>.json and .npz.

--most-relevant 6 calibrates the six parameters that matter most and fixes the others at their priors,
estimates or middles. Which matter is read from `studies sensitivity` where its result lies, else asked of the
FMU by Morris' method: four simulations per parameter and four more, 60 for 14 parameters. What the fixing
cost is asked at the end where calls are left: one per parameter and one more. All of them are counted (and
in --max-calls). The result says what was fixed at what and lies beside that of all parameters: ...-relevant6.

A parameter's prior (case.toml: prior = { about = 0.7, within_factor = 1.5 }) is heeded by both methods.

examples:
  studies calibrate                        the office, 100 FMU calls at most
  studies calibrate my-case --max-calls 60 --parallel 4 --jobs 4
  studies calibrate my-case --target 0.0121 --json
  studies calibrate my-case --from-stored  after a change of data, weights, priors or bounds: a few calls
  studies calibrate my-case --most-relevant 6   of 14: 60 of the 100 calls say which six, 15 what that cost
  studies calibrate --n-train 64           from the surrogate that 64 simulations taught
  studies calibrate --n-train 64 --again   once more: the same numbers
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)
    options.add_simulation(command)
    command.add_argument(
        "--method",
        choices=("adaptive", "paper"),
        help="adaptive (default): fewest FMU calls, no training set; "
        "paper (default with --n-train): screen on the surrogate, polish",
    )
    command.add_argument(
        "--parallel",
        type=values.whole(1, 64),
        metavar="Q",
        help="adaptive: simulations side by side; default: 1",
    )
    command.add_argument(
        "--from-stored",
        action="store_true",
        help="adaptive: begin with the simulations of this model that are stored",
    )
    command.add_argument(
        "--state-equations",
        action=argparse.BooleanOptionalAction,
        help="adaptive: learn the FMU's state equations, or do without; default: where it shows its states",
    )
    options.add_most_relevant(
        command,
        "calibrate the K most relevant parameters, fix the others at prior, estimate or middle; without "
        "Sobol indices, to find them takes 4 calls per parameter and 4 more",
    )
    options.add_sizes(command, "paper: sizes to calibrate with; default: all that have a surrogate")
    options.add_calibration(
        command,
        max_calls="most FMU calls, of all (adaptive; default: 100) or of one polish (paper; the profile's)",
        target="adaptive: go on until this error; paper: also say how many calls reached it",
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.method == "adaptive" and chosen.n_train:
        raise InputError(
            "--n-train belongs to --method paper; the adaptive one has no training set, leave it away"
        )
    is_paper = chosen.method == "paper" or bool(chosen.n_train)
    only_adaptive = {
        "--parallel": chosen.parallel is not None,
        "--from-stored": chosen.from_stored,
        "--state-equations": bool(chosen.state_equations),
        "--no-state-equations": chosen.state_equations is False,
    }
    for option, is_given in only_adaptive.items():
        if is_paper and is_given:
            raise InputError(
                f"{option} belongs to --method adaptive; leave it or --n-train and --method away"
            )
    return _from_surrogates(chosen, console) if is_paper else _adaptively(chosen, console)


def _from_surrogates(chosen: argparse.Namespace, console: Console) -> int:
    from studies.stages.calibrate import calibrate_stage, tuned_sizes
    from studies.stages.calibrated_values import (
        judged_values,
        show_calibrations,
        show_values,
        target_numbers,
    )
    from studies.stages.guideline import guideline_numbers
    from studies.stages.restriction import checked_size

    study = open_study(chosen, console)
    n_free = None if chosen.most_relevant is None else checked_size(study.case, chosen.most_relevant)
    sizes = tuned_sizes(study, chosen.n_train)
    outcomes = [calibrate_stage(study, n_train, n_free=n_free, again=chosen.again) for n_train in sizes]
    show_calibrations(study, outcomes, chosen.target)
    show_values(study, outcomes)
    judged = {
        outcome.summary["n_train"]: guideline_numbers(judged_values(study, outcome.summary))
        for outcome in outcomes
    }
    told = target_numbers(study, outcomes, chosen.target)
    return hand_over(study, "calibrate", outcomes, guideline14=judged, **told)


def _adaptively(chosen: argparse.Namespace, console: Console) -> int:
    from studies.stages.adaptive import adaptive_settings, adaptive_stage
    from studies.stages.adaptive_shown import (
        calls_to,
        judged_adaptive,
        show_adaptive,
        show_replaced,
        stored_before,
    )
    from studies.stages.guided import are_state_equations_learnt
    from studies.stages.guideline import guideline_numbers
    from studies.stages.restriction import calls_for_relevance, checked_size

    study = open_study(chosen, console)
    n_free = None if chosen.most_relevant is None else checked_size(study.case, chosen.most_relevant)
    state_equations = are_state_equations_learnt(study.case, chosen.state_equations)
    settings = adaptive_settings(
        study.case,
        max_calls=chosen.max_calls,
        n_parallel=chosen.parallel,
        target_mse=chosen.target,
        n_free=n_free,
        n_calls_before=0 if n_free is None else calls_for_relevance(study),
        from_stored=chosen.from_stored,
        state_equations=state_equations,
    )
    before = stored_before(study, n_free)
    outcome = adaptive_stage(
        study,
        settings,
        n_free=n_free,
        from_stored=chosen.from_stored,
        state_equations=state_equations,
        again=chosen.again,
    )
    show_adaptive(study, outcome)
    show_replaced(study, before, outcome)
    targets = {known.mse for known in study.case.references if known.is_target} | {chosen.target} - {None}
    return hand_over(
        study,
        "calibrate",
        [outcome],
        method="adaptive",
        guideline14=guideline_numbers(judged_adaptive(study, outcome)),
        calls_to_target={f"{target:g}": calls_to(study, target, n_free) for target in sorted(targets)},
    )
