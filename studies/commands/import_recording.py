"""Check a published recording and store it as a case's CSV.

What happens: the command reads a recording as it was published, with the time in s in the first column.
TRoom, TEnv, TSupply, FlowSupply, TRLTSupply, RLTFlow and IrrGH have values every 1800 s, Occupancy every
600 s. The command checks the recording and writes data/office-recorded/recording_1800s.csv and
occupancy_600s.csv for the case office-recorded. The embedded cases that read these files are copied into
fmus/ of the project.

Examples:
  studies import-recording identification_data.mat
  studies import-recording ThermalNetwork.fmu
  studies import-recording recording       a folder with recording_1800s.csv and occupancy_600s.csv
"""

import argparse
from dataclasses import asdict
from pathlib import Path

from studies.commands.hand_over import OK
from studies.commands.options import Option
from studies.embedded import adopt_cases
from studies.paths import find_project, mark_project
from studies.words.console import Column, Console

OPTIONS = (
    Option(
        "file", metavar="FILE", help="a .mat file, an FMU that contains it, or a folder with the CSV files"
    ),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.recording_import import import_recording

    paths = find_project(chosen.storage, chosen.tracking)
    report = import_recording(Path(chosen.file).expanduser(), paths.data / "office-recorded")
    mark_project(paths, console)
    for file in adopt_cases(paths.root, "office-recorded"):
        console.say(f"{paths.show(file)}: copied from the embedded case, because it reads this recording")
    files = [paths.show(file) for file in report.files]
    console.table(
        f"imported from {report.source}",
        [Column("file"), Column("rows", True)],
        list(zip(files, report.n_rows, strict=True)),
    )
    console.result(f"{report.duration_d:.2f} days; calibrate against them: studies calibrate office-recorded")
    if chosen.file.lower().endswith(".fmu"):
        authors = paths.show(paths.fmus / "office-authors" / "ThermalNetwork.fmu")
        console.result(f"this FMU itself: copy it to {authors}, and studies calibrate office-authors")
    console.document({"command": "import-recording", **asdict(report), "files": files})
    return OK
