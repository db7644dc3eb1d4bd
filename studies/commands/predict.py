"""Simulate a calibrated model with other inputs.

What happens: the command simulates the calibrated parameters over the whole time of another CSV file. The
file has the time and every column that drives an input of the case. If these stand in several files, name a
folder that holds files of the same names. The simulation starts with the first row, with the start values
and the fixed values of the case. After studies uncertainty it also simulates the
equally good parameter sets, one simulation each. The result then has bands: of the simulated outputs, and of
a measurement with its noise. Each simulation is stored: after an interruption, the same command goes on.

Where the case has experiments, --experiment names the one whose parameters, start and fixed values count;
one that is held out may be named as well. Without --inputs its own recording drives it, and the picture shows
what was measured.

Results: mlruns/results/<label>/predict-<calibration>-<file>-<digest>.csv and .png, and a run in MLflow. The
digest is that of the model with these inputs, so files of one name do not replace each other's results.

Examples:
  studies predict office --inputs next-winter.csv
  studies predict office --inputs next-winter.csv --method paper --n-train 64
  studies predict room --experiment summer
"""

import argparse
from pathlib import Path

from studies.commands import options
from studies.commands.hand_over import document, keywords_of
from studies.words.console import Console

OPTIONS = (
    *options.SIMULATED,
    options.Option(
        "--inputs",
        type=Path,
        metavar="FILE",
        help="CSV file with the columns of the inputs, or a folder of such files",
    ),
    options.experiment("the experiment to simulate, of a case with several"),
    *options.CALIBRATION,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.judgements import predict

    result = predict(**keywords_of(chosen, console))
    task, found = result.task, result.outcome.result
    table = task.paths.root / found.table
    console.result(f"Table: {task.paths.show(table)}")
    console.result(f"Picture: {task.paths.show(table.with_suffix('.png'))}")
    if found.level is None:
        console.result(f"No bands: type studies uncertainty {task.command}, then this command again")
    if found.n_failed:
        console.warn(f"{found.n_failed} of {found.n_sample} simulations of the bands failed and are left out")
    return document(task, "predict", [result.outcome])
