"""Show the best model per size and the best calibration of each case.

What happens: the table shows the best trial of each label (case and profile) and training-set size. Best
means the least validation error among completed trials. Beside its hyperparameters and errors stand the
errors of PCA + GP. The column "gain" is the part of the default configuration's validation error that tuning
took away. Below the table: Python lines that load the study and the model, and the best calibration of
each case on its latest measurement. Without --write the command writes nothing.

--write writes the best calibration of one case to a new file; it replaces no file. The values have the units
of the FMU. What the case holds under [fixed] is written with them. The formats are ssv (System Structure
Parameter Values), modelica, csv, json, and fmu, a copy of the FMU with these start values. Some importers do
not set start values of a description: docs/how-to/values.md. onnx writes the surrogate of least validation
error. A warning names what changed since the calibration: the case file, its window, weights or data.

Examples:
  studies best                             all labels and sizes
  studies best office                      one case
  studies best office-quick --json         one label, for programs
  studies best office --write ssv          the calibrated parameters, for a simulator
  studies best office --n-train 64 --write onnx office.onnx
"""

import argparse

from simulation.errors import InputError
from studies.commands import options
from studies.words.console import Console

OPTIONS = (
    options.WHICH,
    options.Option("--n-train", type=int, metavar="N", help="with --write onnx: its training-set size"),
    options.experiment("with --write: the experiment whose values are written"),
    options.Option(
        "--write",
        nargs="+",
        metavar=("FORMAT", "FILE"),
        help="write the best calibration to a new file: ssv, modelica, csv, json, or fmu; "
        "onnx: the best surrogate; default of FILE: named after the case, in the working folder",
    ),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.projects import best
    from studies.project import best_blocks

    if chosen.n_train is not None and (chosen.write or [""])[0] != "onnx":
        raise InputError("--n-train chooses the surrogate of --write onnx; write that, or leave it out")
    if chosen.experiment is not None and (chosen.write or ["onnx"])[0] == "onnx":
        raise InputError("--experiment chooses the values of --write; write them, or leave it out")
    result = best(chosen.which, storage=chosen.storage, tracking=chosen.tracking)
    project, document = result.project, result.numbers
    if chosen.write:
        from studies.exports.written_file import write_best

        file, stale = write_best(project, chosen.write, chosen.n_train, chosen.experiment)
        document["written"] = str(file)
        console.result(f"written: {file}")
        if stale:
            console.warn(f"{file}: {stale}")
    else:
        console.show(best_blocks(project))
    console.document(document)
    return 0
