"""`studies ui`: open MLflow's user interface on this project's runs."""

import argparse
import os
from pathlib import Path

from studies.commands import values
from studies.console import Console
from studies.paths import find_project

HELP = "open MLflow's user interface on this project's runs"
MORE = """\
what happens: starts MLflow's server on this project's store and prints the address of a leaderboard:
the best surrogate per training-set size, what tuning gained, what the calibrations came to. From there
to every study, its trials and their pictures. Ctrl-C stops the server.

By default only this machine can reach it. On another address it asks for the password of its user
'admin': at least 12 characters in $MLFLOW_AUTH_ADMIN_PASSWORD, or typed when first asked. Users are kept
in mlruns/access. The connection is not encrypted; a tunnel (ssh -L 5000:127.0.0.1:5000) is.

examples:
  studies ui
  studies ui office-quick --open           that leaderboard, in the browser
  studies ui --port 8080
  studies ui --host 0.0.0.0                for a network, with a password
  studies ui --dry-run --json              what would be started
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "label",
        nargs="?",
        metavar="LABEL",
        help="<case>-<profile> whose leaderboard is shown; default: the one worked on last",
    )
    command.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on; default: 127.0.0.1"
    )
    command.add_argument(
        "--port",
        type=values.port,
        metavar="N",
        help="port; default: 5000 or the next free one",
    )
    command.add_argument("--open", action="store_true", help="open the address in this machine's browser")
    command.add_argument("--dry-run", action="store_true", help="print what would be started and stop there")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.keeping.rebuild import rebuild_mlflow
    from studies.tracking.ui_server import open_ui

    paths = find_project(chosen.storage)
    # MLflow's server, uvicorn, looks for modules in the working folder first; so in one of ours.
    os.environ.setdefault("UVICORN_APP_DIR", str(Path(__file__).resolve().parents[2]))
    if not chosen.dry_run:
        rebuild_mlflow(paths, console)
    return open_ui(
        paths,
        console,
        label=chosen.label,
        host=chosen.host,
        port=chosen.port,
        browse=chosen.open,
        dry_run=chosen.dry_run,
    )
