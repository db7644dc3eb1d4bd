"""Start MLflow's user interface on this project's store, on this machine alone."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import webbrowser
from dataclasses import dataclass
from typing import Any, NoReturn
from urllib.parse import quote

from simulation.errors import InputError
from simulation.workers.held_interrupts import interrupts_held
from studies.console import Console
from studies.interrupts import interrupt_heeded
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords

LOG_FILE = "ui.log"
HOST = "127.0.0.1"
FIRST_PORT, N_PORTS = 5000, 100
START_LIMIT_S, STOP_LIMIT_S = 120.0, 10.0
ENVIRONMENT = {
    # The job runners that MLflow would start take two gigabytes, and nothing here uses them.
    "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
}
LEADERBOARD = "tags.best = 'yes'"


@dataclass(frozen=True)
class UiPlan:
    """What would be started.

    Args:
        argv: the program and its arguments.
        environment: variables added to the environment, the store's URL among them.
        address: where the server answers.
    """

    argv: tuple[str, ...]
    environment: dict[str, str]
    address: str

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as JSON values, without passwords."""
        shown = {name: hide_passwords(value) for name, value in self.environment.items()}
        return {"argv": list(self.argv), "environment": shown, "url": self.address}


def open_ui(
    paths: ProjectPaths, console: Console, *, label: str | None, port: int | None, browse: bool, dry_run: bool
) -> int:
    """Start the interface and wait until the user stops it.

    Args:
        paths: the project.
        console: prints the addresses.
        label: whose best trials are shown first; None for the one that was worked on last.
        port: port to listen on; None takes the first free one from 5000 on.
        browse: also open the address in this machine's browser.
        dry_run: only say what would be started.

    Returns:
        The exit code.

    Raises:
        InputError: there is no store yet, the port is taken or the label is unknown.
    """
    if paths.storage is None and not paths.tracking_database.is_file() and not dry_run:
        raise InputError(f"there is no {paths.show(paths.tracking_database)} yet; type: studies run")
    plan = plan_ui(paths, port)
    if dry_run:
        document = {"command": "ui", **plan.to_dict(), "dry_run": True}
        variables = " ".join(f"{name}={value}" for name, value in document["environment"].items())
        console.result(f"{variables} {' '.join(plan.argv)}")
        console.document(document)
        return 0
    pages = _pages(paths, label)
    console.say("ui: starting MLflow")
    signal.signal(signal.SIGTERM, interrupt)
    log = paths.mlruns / LOG_FILE
    with log.open("w", encoding="utf-8") as messages, interrupts_held() as release:
        # A session of its own: Ctrl-C comes to this process alone, which stops all that MLflow has started.
        server = subprocess.Popen(
            plan.argv,
            cwd=paths.mlruns,
            env=os.environ | plan.environment,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            start_new_session=True,
        )
        try:
            release()
            if _is_up(server, plan.address):
                for what, page in pages.items():
                    console.result(f"{what}: {plan.address}{page}")
                console.result("Ctrl-C stops it.")
                first = next(iter(pages.values()))
                document = {
                    "command": "ui",
                    **plan.to_dict(),
                    "url": f"{plan.address}{first}",
                    "dry_run": False,
                }
                console.document(document)
                if browse:
                    webbrowser.open(plan.address + first)
                server.wait()
            console.warn(f"error: MLflow ended by itself; {paths.show(log)} says why")
            return 1
        except KeyboardInterrupt:
            interrupt_heeded()
            console.say("ui: stopped")
            return 0
        finally:
            _stop(server)


def plan_ui(paths: ProjectPaths, port: int | None) -> UiPlan:
    """Return what would be started.

    Raises:
        InputError: the port is taken.
    """
    if port is not None and not _is_free(port):
        raise InputError(f"port {port} is taken; choose another one or leave --port away")
    chosen = port or next((n for n in range(FIRST_PORT, FIRST_PORT + N_PORTS) if _is_free(n)), None)
    if chosen is None:
        raise InputError(f"no port from {FIRST_PORT} to {FIRST_PORT + N_PORTS} is free; give one with --port")
    argv = [sys.executable, "-P", "-m", "mlflow", "server", "--host", HOST, "--port", str(chosen)]
    argv += ["--workers", "1", "--default-artifact-root", paths.artifacts.as_uri(), "--no-serve-artifacts"]
    # The store's URL may hold a password: not in the arguments, which every user of a machine can read.
    uri = paths.tracking_uri
    environment = {**ENVIRONMENT, "MLFLOW_BACKEND_STORE_URI": uri, "MLFLOW_TRACKING_URI": uri}
    return UiPlan(tuple(argv), environment, f"http://{HOST}:{chosen}/")


def _pages(paths: ProjectPaths, label: str | None) -> dict[str, str]:
    """Return the addresses of a label's leaderboard, of all its runs, and of the registered models."""
    from mlflow.entities import ViewType

    from studies.tracking.stage_run import run_store

    client = run_store(paths).client
    experiments = client.search_experiments(
        view_type=ViewType.ACTIVE_ONLY, order_by=["last_update_time DESC"]
    )
    known = {one.name: one.experiment_id for one in experiments if one.name != "Default"}
    if label is not None and label not in known:
        raise InputError(f"MLflow has no experiment {label!r}; there are: {', '.join(known) or 'none'}")
    if not known:
        return {"MLflow, without a run yet": ""}
    chosen = label or next(iter(known))
    runs = f"#/experiments/{known[chosen]}/runs?workflowType=machine_learning"
    return {
        f"Best trial per training-set size of {chosen}": f"{runs}&searchFilter={quote(LEADERBOARD)}",
        f"All runs of {chosen}": runs,
        "Registered models": "#/models",
    }


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def interrupt(number: int, frame: object) -> NoReturn:
    """Turn a polite request to end into Ctrl-C, so that the server is stopped on either."""
    raise KeyboardInterrupt


def _is_up(server: "subprocess.Popen[bytes]", url: str) -> bool:
    """Wait until the server answers; return whether it does."""
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and server.poll() is None:
        try:
            with urllib.request.urlopen(f"{url}health", timeout=2.0):
                return True
        except OSError:
            time.sleep(0.2)
    return False


def _stop(server: "subprocess.Popen[bytes]") -> None:
    for how in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(server.pid, how)
        except ProcessLookupError:
            return
        try:
            server.wait(STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            continue
