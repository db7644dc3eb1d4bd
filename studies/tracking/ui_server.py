"""Start MLflow's user interface on this project's store, on loopback, and stop it cleanly."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass
from typing import Any, NoReturn

from simulation.errors import InputError
from studies.console import Console
from studies.paths import ProjectPaths

HOST = "127.0.0.1"
LOG_FILE = "ui.log"
FIRST_PORT, N_PORTS = 5000, 100
START_LIMIT_S, STOP_LIMIT_S = 120.0, 10.0
ENVIRONMENT = {
    # The job runners that MLflow would start take two gigabytes, and nothing here uses them.
    "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
}


@dataclass(frozen=True)
class UiPlan:
    """What would be started.

    Args:
        argv: the program and its arguments.
        environment: variables added to the environment.
        url: where the interface answers, in the mode for experiments.
    """

    argv: tuple[str, ...]
    environment: dict[str, str]
    url: str

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as JSON values."""
        return {"argv": list(self.argv), "environment": self.environment, "url": self.url}


def open_ui(paths: ProjectPaths, console: Console, *, port: int | None, dry_run: bool) -> int:
    """Start the interface and wait until the user stops it.

    Args:
        paths: the project.
        console: tells the address.
        port: port to listen on; None takes the first free one from 5000 on.
        dry_run: only say what would be started.

    Returns:
        The exit code.

    Raises:
        InputError: there is no store yet, or the port is taken.
    """
    plan = plan_ui(paths, port)
    document = {"command": "ui", **plan.to_dict(), "dry_run": dry_run}
    if dry_run:
        variables = " ".join(f"{name}={value}" for name, value in plan.environment.items())
        console.result(f"{variables} {' '.join(plan.argv)}")
        console.result(f"address: {plan.url}")
        console.document(document)
        return 0
    if not paths.tracking_database.is_file():
        raise InputError(f"there is no {paths.show(paths.tracking_database)} yet; type: studies run")
    console.say("ui: starting MLflow")
    signal.signal(signal.SIGTERM, _interrupt)
    log = paths.mlruns / LOG_FILE
    with log.open("w", encoding="utf-8") as messages:
        # A session of its own: Ctrl-C comes to this process alone, which stops all that MLflow has started.
        server = subprocess.Popen(
            plan.argv,
            env=os.environ | plan.environment,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            start_new_session=True,
        )
        try:
            if _is_up(server, plan.url):
                console.result(f"MLflow shows this project's runs at {plan.url}")
                console.result("Ctrl-C stops it.")
                console.document(document)
                server.wait()
            console.warn(f"error: MLflow ended by itself; {paths.show(log)} says why")
            return 1
        except KeyboardInterrupt:
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
        raise InputError(f"port {port} on {HOST} is taken; choose another one or leave --port away")
    chosen = port or next((n for n in range(FIRST_PORT, FIRST_PORT + N_PORTS) if _is_free(n)), None)
    if chosen is None:
        raise InputError(f"no port from {FIRST_PORT} to {FIRST_PORT + N_PORTS} is free; give one with --port")
    argv = [sys.executable, "-m", "mlflow", "server", "--host", HOST, "--port", str(chosen), "--workers", "1"]
    argv += ["--backend-store-uri", f"sqlite:///{paths.tracking_database.as_posix()}"]
    argv += ["--default-artifact-root", paths.artifacts.as_uri(), "--no-serve-artifacts"]
    return UiPlan(tuple(argv), dict(ENVIRONMENT), f"http://{HOST}:{chosen}/?workflowType=machine_learning")


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def _interrupt(number: int, frame: object) -> NoReturn:
    """Turn a polite request to end into Ctrl-C, so that the server is stopped on either."""
    raise KeyboardInterrupt


def _is_up(server: "subprocess.Popen[bytes]", url: str) -> bool:
    """Wait until the server answers; return whether it does."""
    deadline = time.monotonic() + START_LIMIT_S
    health = url.split("?")[0] + "health"
    while time.monotonic() < deadline and server.poll() is None:
        try:
            with urllib.request.urlopen(health, timeout=2.0):
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
