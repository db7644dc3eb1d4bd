"""`studies ui`: open MLflow's user interface on this project's runs."""

import argparse

from studies.commands import values
from studies.console import Console
from studies.paths import find_project

HELP = "open MLflow's user interface on this project's runs"
MORE = """\
what happens: starts `mlflow ui` on 127.0.0.1 with this project's store (mlruns/mlflow.db) and prints
the address. Ctrl-C stops it.

examples:
  studies ui
  studies ui --port 8080
  studies ui --dry-run --json              what would be started
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "--port",
        type=values.port,
        metavar="N",
        help="port on 127.0.0.1; default: 5000 or the next free one",
    )
    command.add_argument("--dry-run", action="store_true", help="print what would be started and stop there")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.tracking.ui_server import open_ui

    return open_ui(find_project(), console, port=chosen.port, dry_run=chosen.dry_run)
