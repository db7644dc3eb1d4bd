"""`studies import`: take over the studies of an archive."""

import argparse

from studies.commands.study import OK
from studies.console import Column, Console
from studies.marker import mark_project
from studies.paths import find_project

HELP = "take over the studies and results of an archive that studies export has written"
MORE = """\
what happens: checks every file of the archive, then writes what is not here yet: trials, champions,
results, sets of rows, simulations; and shows it in Optuna and MLflow. A study that is here already is
merged trial by trial; where a trial here says something else, nothing is imported and one line says so.
Results of stages that are finished here stay as they are. Importing twice changes nothing; after an
interruption type the command again. (A recording is imported by `studies import-recording`.)

examples:
  studies import office-quick.tar.gz
  STUDIES_STORAGE=postgresql://me@server/studies studies import office-quick.tar.gz
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument("file", metavar="ARCHIVE", help="the archive")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from pathlib import Path

    from studies.keeping.importing import import_archive
    from studies.keeping.wording import told_contents

    paths = find_project(chosen.storage)
    done = import_archive(paths, Path(chosen.file).expanduser(), console)
    mark_project(paths.root, console)
    columns = [Column("study"), Column("new trials", True), Column("here before", True)]
    contents = told_contents(
        n_studies=sum(n > 0 for n in done.new.values()),
        n_trials=sum(done.new.values()),
        n_champions=len(done.champions),
        stages=done.stages,
        n_rows=done.n_rows,
    )
    console.result(f"{chosen.file}: new here: {contents}")
    if done.new:
        rows = [[name, n, done.known[name]] for name, n in done.new.items()]
        console.table(f"studies of {chosen.file}", columns, rows)
    for what, names in (("champions", done.champions), ("results", done.stages)):
        if names:
            console.result(f"{what}: {', '.join(names)}")
    for note in done.notes:
        console.say(f"note: {note}")
    console.document({"command": "import", **done.to_dict()})
    return OK
