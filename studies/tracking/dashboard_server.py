"""Serve Optuna Dashboard on this project's studies, on loopback, in this process."""

import importlib.util
import logging
import signal
import threading
from socketserver import ThreadingMixIn
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from simulation.errors import InputError
from studies.console import Console
from studies.interrupts import interrupt_heeded
from studies.paths import ProjectPaths
from studies.tracking.ui_access import LOOPBACK
from studies.tracking.ui_server import free_port, interrupt

FIRST_PORT = 8080
JOURNAL = "optuna.journal"


def open_dashboard(paths: ProjectPaths, console: Console, *, port: int | None) -> int:
    """Serve the dashboard until the user stops it.

    Args:
        paths: the project.
        console: tells the address.
        port: port to listen on; None takes the first free one from 8080 on.

    Returns:
        The exit code.

    Raises:
        InputError: the dashboard is not installed, there is no study yet, or the port is taken.
    """
    if importlib.util.find_spec("optuna_dashboard") is None:
        raise InputError("Optuna Dashboard is not installed; type: pip install 'optuna-dashboard>=0.18'")
    chosen = free_port(LOOPBACK, port, FIRST_PORT)
    if paths.storage is None and not (paths.mlruns / JOURNAL).is_file():
        raise InputError(f"there is no {paths.show(paths.mlruns / JOURNAL)} yet; type: studies tune")
    console.say("dashboard: starting Optuna Dashboard")
    from optuna_dashboard import wsgi

    from studies.tuning.study_store import open_optuna

    storage = open_optuna(paths)

    for name in ("optuna", "optuna_dashboard"):
        logging.getLogger(name).setLevel(logging.ERROR)
    signal.signal(signal.SIGTERM, interrupt)
    url = f"http://{LOOPBACK}:{chosen}/dashboard/"
    with make_server(LOOPBACK, chosen, wsgi(storage), _Server, _QuietHandler) as server:
        serving = threading.Thread(target=server.serve_forever, daemon=True)
        serving.start()
        try:
            # Whoever reads the address may already press Ctrl-C.
            console.result(f"Optuna Dashboard shows this project's studies at {url}")
            console.result("Ctrl-C stops it.")
            console.document({"command": "dashboard", "url": url})
            serving.join()
        except KeyboardInterrupt:
            interrupt_heeded()
            console.say("dashboard: stopped")
        finally:
            server.shutdown()
    return 0


class _Server(ThreadingMixIn, WSGIServer):
    """Answers several requests at once: the page asks for many things."""

    daemon_threads = True


class _QuietHandler(WSGIRequestHandler):
    """Answers without a line per request."""

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Say nothing."""
