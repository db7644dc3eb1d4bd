"""`studies dashboard`: open Optuna Dashboard on this project's studies."""

import argparse

from studies.commands import values
from studies.console import Console
from studies.paths import find_project

HELP = "open Optuna Dashboard on this project's studies"
MORE = """\
what happens: serves Optuna Dashboard on 127.0.0.1 with this project's studies (mlruns/optuna.journal, or
the PostgreSQL of --storage) and prints the address. Ctrl-C stops it. It has to be installed:
pip install 'optuna-dashboard>=0.18'.

examples:
  studies dashboard
  studies dashboard --port 8090
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "--port",
        type=values.port,
        metavar="N",
        help="port on 127.0.0.1; default: 8080 or the next free one",
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.tracking.dashboard_server import open_dashboard

    return open_dashboard(find_project(chosen.storage), console, port=chosen.port)
