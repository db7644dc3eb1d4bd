"""`studies export`: pack studies into one archive that can be imported elsewhere."""

import argparse

from studies.commands.study import OK
from studies.console import Console
from studies.paths import find_project

HELP = "pack studies with all that belongs to them into one archive"
MORE = """\
what happens: gathers the studies with all their trials, pruned and failed ones included (records, learning
curves, weights of the best), what rebuilds them (recipe: case, profile, seeds), the sets of rows, the
champions and the results of their labels (calibrations, uncertainties, Sobol indices), and packs them with
checksums into one file. Simulations stay behind unless --with-simulations is given: they can be done again.
Nothing here is changed. `studies import` takes it over elsewhere, also into or out of a PostgreSQL storage.

examples:
  studies export office-quick --to office-quick.tar.gz
  studies export office-quick/n0064 'room-*' --to two.tar.gz
  studies export office-quick --with-simulations --to all.tar.gz
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "which", nargs="+", metavar="STUDY", help="a label, label/n0064, a whole name, or a pattern of them"
    )
    command.add_argument("--to", required=True, metavar="FILE", help="the archive, such as study.tar.gz")
    command.add_argument("--with-simulations", action="store_true", help="the simulated rows as well")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from pathlib import Path

    from studies.keeping.export import export
    from studies.keeping.wording import readable, told_contents

    file = Path(chosen.to).expanduser()
    made = export(
        find_project(chosen.storage), chosen.which, file, console, with_simulations=chosen.with_simulations
    )
    contents = told_contents(
        n_studies=len(made.studies),
        n_trials=made.n_trials,
        n_champions=len(made.champions),
        stages=made.stages,
        n_rows=made.n_rows,
    )
    console.result(f"{made.file}: {contents}; {readable(made.size)}")
    console.result(f"take it over elsewhere: studies import {made.file.name}")
    console.document({"command": "export", **made.to_dict()})
    return OK
