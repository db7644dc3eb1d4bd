"""Show which measurement would show most of the parameters.

What happens: the command takes a finished calibration. From the slopes of the outputs it computes which
half widths the 90 % intervals are expected to have after each candidate was measured, too. State equations
give these slopes for any inputs, without a simulation; one simulation then checks the best candidate. Else
each candidate takes two simulations per parameter, and one. After studies uncertainty, half widths are
averaged over equally good parameter sets, where equations are known.

Candidates: without options these are other windows of the recording, as long as the present one, or the
experiments that are held out. --inputs adds recordings of inputs. --vary adds courses of an input that may
be set: a step, random steps, nights. --output adds a sensor. A candidate that leads an output beyond its
limits (at_least, at_most) is left out.

A candidate that begins anew has its own start: parameters that act on the start alone are then unknown. Its
noise is that of the present measurement, sampled as often.

Results: mlruns/results/<label>/next-<calibration>.json, the [[experiments]] table of the best candidate
beside it as .toml, with its inputs; a run in MLflow.

Examples:
  studies next office
  studies next office --inputs next-winter.csv
  studies next two-rooms --vary q1=0:1500 --criterion D
  studies next room --output TWall=0.1
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, keywords_of
from studies.commands.options import Option
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    Option(
        "--inputs", nargs="+", metavar="FILE", help="CSV files with the columns of the inputs, or folders"
    ),
    Option("--vary", nargs="+", metavar="INPUT=LOW:HIGH", help="inputs that may be set, in the case's units"),
    Option("--output", nargs="+", metavar="NAME=U", help="outputs that may be measured, with uncertainties"),
    Option("--criterion", default="half-widths", help="half-widths (default), A- or D-optimal"),
    *options.CALIBRATION,
    Option("--again", action="store_true", help="repeat what is finished"),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.planning import next_experiment
    from studies.stages.shown import show_planned

    result = next_experiment(**keywords_of(chosen, console))
    show_planned(result.task, result.outcome.result)
    return document(result.task, "next", [result.outcome])
