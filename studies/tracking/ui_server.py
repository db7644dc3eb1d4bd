"""Start MLflow's user interface on this project's store, on this machine alone."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Mapping
from contextlib import suppress

from simulation.errors import InputError, MachineError
from simulation.pool.family import end_with_parent
from simulation.write_gate import check_written
from studies.paths import ProjectPaths
from studies.tracking.leaderboard import CHARTS, TABLE, page_of, set_views
from studies.tracking.sent_runs import sent_runs
from studies.words.console import Console

HOST, FIRST_PORT, N_PORTS = "127.0.0.1", 5000, 100
START_LIMIT_S, STOP_LIMIT_S = 120.0, 10.0
LOG_FILE = "ui.log"
# The job runners that MLflow would start take two gigabytes, and nothing here uses them.
ENVIRONMENT = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false", "MLFLOW_DISABLE_TELEMETRY": "true"}


def open_ui(paths: ProjectPaths, console: Console, *, label: str | None, port: int | None) -> int:
    """Start the interface and wait until the user stops it.

    Args:
        paths: the project.
        console: prints the addresses.
        label: whose runs are shown; None for the one that was worked on last.
        port: port to listen on; None takes the first free one from 5000 on.

    Returns:
        The exit code.

    Raises:
        InputError: there is no store yet, the port is taken or the label is unknown.
        MachineError: MLflow's server does not start.
    """
    sent = sent_runs(paths)
    if sent is not None and paths.server is not None and paths.server.is_remote:
        for what, page in _pages_of(sent.experiments, label).items():
            console.result(f"{what}: {sent.uri}/{page}")
        console.document(
            {"command": "ui", "url": f"{sent.uri}/{next(iter(_pages_of(sent.experiments, label).values()))}"}
        )
        return 0
    if paths.storage is None and not paths.tracking_database.is_file():
        raise InputError(f"there is no {paths.show(paths.tracking_database)} yet; type: studies run")
    log = paths.mlruns / LOG_FILE
    check_written(log)
    chosen = _free_port(port)
    address, pages = f"http://{HOST}:{chosen}/", _pages(paths, label)
    command = [sys.executable, "-P", "-m", "mlflow", "server", "--host", HOST, "--port", str(chosen)]
    command += ["--workers", "1", "--default-artifact-root", paths.artifacts.as_uri(), "--no-serve-artifacts"]
    # The store's URL may hold a password: not in the arguments, which every user of a machine can read.
    store = dict.fromkeys(("MLFLOW_BACKEND_STORE_URI", "MLFLOW_TRACKING_URI"), paths.tracking_uri)
    console.say("ui: starting MLflow")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with log.open("w", encoding="utf-8") as messages:
        # A session of its own: Ctrl-C comes to this process alone, which stops all that MLflow has started.
        server = subprocess.Popen(
            command,
            cwd=paths.mlruns,
            env=os.environ | ENVIRONMENT | store,
            stdout=messages,
            stderr=messages,
            start_new_session=True,
            preexec_fn=end_with_parent,
        )
        try:
            if _is_up(server, f"{address}health"):
                for what, page in pages.items():
                    console.result(f"{what}: {address}{page}")
                console.result("Ctrl-C stops it.")
                console.document({"command": "ui", "url": f"{address}{next(iter(pages.values()))}"})
                server.wait()
            raise MachineError(f"MLflow ended by itself; {paths.show(log)} says why")
        except KeyboardInterrupt:
            console.say("ui: stopped")
            return 0
        finally:
            for how in (signal.SIGTERM, signal.SIGKILL):
                with suppress(ProcessLookupError, subprocess.TimeoutExpired):
                    os.killpg(server.pid, how)
                    server.wait(STOP_LIMIT_S)


def _pages(paths: ProjectPaths, label: str | None) -> dict[str, str]:
    """Return the addresses of a label's best trials, of all its runs, and of the registered models."""
    from studies.tracking.runs import run_store

    runs = run_store(paths)
    experiments = runs.client.search_experiments(order_by=["last_update_time DESC"])
    known = {one.name: one.experiment_id for one in experiments if one.name != "Default"}
    pages = _pages_of(known, label)
    if known:
        set_views(runs, label or next(iter(known)))  # those of before have none
    return pages


def _pages_of(known: Mapping[str, str], label: str | None) -> dict[str, str]:
    if label is not None and label not in known:
        raise InputError(f"MLflow has no experiment {label!r}; there are: {', '.join(known) or 'none'}")
    if not known:
        return {"MLflow, without a run yet": ""}
    chosen = label or next(iter(known))
    return {
        f"Leaderboard of {chosen}, the best trial per training-set size": page_of(known[chosen], TABLE),
        f"Charts of {chosen}, every trial": page_of(known[chosen], CHARTS),
        f"All runs of {chosen}": page_of(known[chosen], None),
        "Registered models": "#/models",
    }


def _free_port(wanted: int | None) -> int:
    for port in [wanted] if wanted is not None else range(FIRST_PORT, FIRST_PORT + N_PORTS):
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
            return port
    raise InputError(f"port {wanted or FIRST_PORT} is taken; choose another one with --port")


def _is_up(server: "subprocess.Popen[bytes]", url: str) -> bool:
    """Wait until the server answers; return whether it does."""
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and server.poll() is None:
        with suppress(OSError), urllib.request.urlopen(url, timeout=2.0):
            return True
        time.sleep(0.2)
    return False
