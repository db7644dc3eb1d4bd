"""Open MLflow's user interface on this project's runs.

What happens: the command starts the server of MLflow on the runs of this project. The server accepts
connections from this machine only, at 127.0.0.1 and not at ::1. The command prints four addresses: the
leaderboard (the best trial per training-set size), charts of every trial, all runs, and the registered
models. Running trials show their curves.
Ctrl-C stops the server.
From another machine use a tunnel: ssh -L 5000:127.0.0.1:5000 HOST.

Optuna has pages of its own: pip install optuna-dashboard, then optuna-dashboard sqlite:///mlruns/optuna.db.

Examples:
  studies ui
  studies ui office-quick                  the page of that label
  studies ui --port 8080
"""

import argparse
import os
from pathlib import Path

from studies.commands import options
from studies.keywords import whole
from studies.paths import find_project
from studies.words.console import Console

OPTIONS = (
    options.Option(
        "label",
        nargs="?",
        metavar="LABEL",
        help="label (<case>-<profile>) that is shown first; default: the latest",
    ),
    options.Option(
        "--port",
        type=whole(1024, 65535),
        metavar="N",
        help="port; default: 5000 or the next free port",
    ),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.tracking.ui_server import open_ui

    # MLflow's server, uvicorn, looks for modules in the working folder first; so in one of ours.
    os.environ.setdefault("UVICORN_APP_DIR", str(Path(__file__).resolve().parents[2]))
    return open_ui(
        find_project(chosen.storage, chosen.tracking),
        console,
        label=chosen.label,
        port=chosen.port,
    )
