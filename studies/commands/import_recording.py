"""`studies import-recording`: check a published recording and store it as a case's CSV."""

import argparse

from studies.commands.study import OK
from studies.console import Column, Console
from studies.paths import find_project

HELP = "check a published recording and store it as a case's CSV"
MORE = """\
what happens: reads a recording as published (variables TRoom, TEnv, TSupply, FlowSupply, TRLTSupply,
RLTFlow, IrrGH every 1800 s and Occupancy every 600 s, first column time in s), checks it, and writes
data/office-recorded/recording_1800s.csv and occupancy_600s.csv for the case office-recorded. The embedded
cases that read them are copied into fmus/ of the project, where they find them.

examples:
  studies import-recording identification_data.mat
  studies import-recording ThermalNetwork.fmu
  studies import-recording recording_1800s.csv occupancy_600s.csv
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "files", nargs="+", metavar="FILE", help="a .mat, the FMU that holds it, CSV files, a folder"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from pathlib import Path

    from studies.embedded import adopt_cases
    from studies.marker import mark_project
    from studies.recording import import_recording

    paths = find_project(chosen.storage)
    report = import_recording(
        [Path(file).expanduser() for file in chosen.files], paths.data / "office-recorded"
    )
    mark_project(paths.root, console)
    for file in adopt_cases(paths.root, "office-recorded"):
        console.say(f"{paths.show(file)}: the embedded case, now in this project with the recording")
    files = [paths.show(file) for file in report.files]
    console.table(
        f"imported from {report.source}",
        [Column("file"), Column("rows", True)],
        list(zip(files, report.n_rows, strict=True)),
    )
    if report.kelvin:
        console.result(f"converted from kelvin: {', '.join(report.kelvin)}")
    console.result(f"{report.duration_d:.2f} days; calibrate against them: studies calibrate office-recorded")
    console.document(
        {
            "command": "import-recording",
            "source": report.source,
            "files": files,
            "n_rows": report.n_rows,
            "duration_d": report.duration_d,
            "converted_from_kelvin": report.kelvin,
        }
    )
    return OK
