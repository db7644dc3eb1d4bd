"""Start MLflow's user interface on this project's store, on loopback or with passwords."""

import errno
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

from simulation.errors import InputError
from simulation.workers.held_interrupts import interrupts_held
from studies.console import Console
from studies.interrupts import interrupt_heeded
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords
from studies.tracking.ui_access import (
    BROWSER_NAME,
    LOOPBACK,
    PASSWORD_VARIABLE,
    is_loopback,
    loopback_environment,
    network_environment,
    shown,
)
from studies.tracking.ui_address import leaderboard_page

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
        environment: variables added to the environment, secrets among them.
        server: where the server answers.
        address: what a browser is given.
    """

    argv: tuple[str, ...]
    environment: dict[str, str]
    server: str
    address: str

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as JSON values, without secrets."""
        told = {name: hide_passwords(value) for name, value in shown(self.environment).items()}
        return {"argv": list(self.argv), "environment": told, "url": self.address}


def open_ui(
    paths: ProjectPaths,
    console: Console,
    *,
    label: str | None,
    host: str,
    port: int | None,
    browse: bool,
    dry_run: bool,
) -> int:
    """Start the interface and wait until the user stops it.

    Args:
        paths: the project.
        console: tells the address.
        label: whose leaderboard is opened; None for the one that was worked on last.
        host: address to listen on; one that others can reach needs a password.
        port: port to listen on; None takes the first free one from 5000 on.
        browse: also open the address in this machine's browser.
        dry_run: only say what would be started.

    Returns:
        The exit code.

    Raises:
        InputError: there is no store yet, the port is taken, the label is unknown, or a password is missing.
    """
    # Before a password is asked for.
    if label is not None:
        _require_known(paths, label)
    elif not dry_run:
        _require_store(paths)
    plan = plan_ui(paths, host, port, ask=not dry_run)
    if dry_run:
        document = {"command": "ui", **plan.to_dict(), "dry_run": True}
        variables = " ".join(f"{name}={value}" for name, value in document["environment"].items())
        console.result(f"{variables} {' '.join(plan.argv)}")
        console.result(f"address: {plan.address}")
        console.document(document)
        return 0
    console.say("ui: starting MLflow")
    signal.signal(signal.SIGTERM, interrupt)
    paths.mlruns.mkdir(parents=True, exist_ok=True)
    log = paths.mlruns / LOG_FILE
    with log.open("w", encoding="utf-8") as messages, interrupts_held() as release:
        # A session of its own: Ctrl-C comes to this process alone, which stops all that MLflow has started.
        server = subprocess.Popen(
            plan.argv,
            env=os.environ | plan.environment,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            start_new_session=True,
        )
        try:
            release()
            if _is_up(server, plan.server):
                password = plan.environment.get(PASSWORD_VARIABLE, "")
                page = leaderboard_page(plan.server, label=label, password=password)
                _tell(console, plan, page, host)
                if browse:
                    webbrowser.open(plan.address + page)
                server.wait()
            console.warn(f"error: MLflow ended by itself; {paths.show(log)} says why")
            return 1
        except KeyboardInterrupt:
            interrupt_heeded()
            console.say("ui: stopped")
            return 0
        finally:
            _stop(server)


def _require_store(paths: ProjectPaths) -> None:
    if paths.storage is None and not paths.tracking_database.is_file():
        raise InputError(f"there is no {paths.show(paths.tracking_database)} yet; type: studies run")


def _require_known(paths: ProjectPaths, label: str) -> None:
    from studies.keeping.mlflow_tables import experiment_names

    _require_store(paths)
    names = experiment_names(paths)
    if label not in names:
        raise InputError(f"MLflow has no experiment {label!r}; there are: {', '.join(names) or 'none'}")


def plan_ui(paths: ProjectPaths, host: str, port: int | None, *, ask: bool = True) -> UiPlan:
    """Return what would be started.

    Args:
        paths: the project.
        host: address to listen on.
        port: port to listen on; None takes the first free one.
        ask: whether a missing password is asked for.

    Raises:
        InputError: the port is taken, or a password is missing.
    """
    chosen = free_port(host, port, FIRST_PORT)
    argv = [sys.executable, "-m", "mlflow", "server", "--host", host, "--port", str(chosen), "--workers", "1"]
    argv += ["--default-artifact-root", paths.artifacts.as_uri(), "--no-serve-artifacts"]
    # A server's URL holds its password: not in the arguments, which every user of a machine can read.
    environment = {**ENVIRONMENT, "MLFLOW_BACKEND_STORE_URI": paths.tracking_uri}
    server = f"http://{LOOPBACK if host in ('0.0.0.0', 'localhost') else host}:{chosen}/"
    if is_loopback(host):
        environment |= loopback_environment(chosen)
        return UiPlan(tuple(argv), environment, server, f"http://{BROWSER_NAME}:{chosen}/")
    argv += ["--app-name", "basic-auth"]
    environment |= network_environment(paths, host, chosen, ask=ask)
    name = socket.gethostname() if host == "0.0.0.0" else host
    return UiPlan(tuple(argv), environment, server, f"http://{name}:{chosen}/")


def free_port(host: str, port: int | None, first: int) -> int:
    """Return a port that is free.

    Args:
        host: address to listen on.
        port: the one that is wanted; None takes the first free one.
        first: where to begin looking.

    Raises:
        InputError: the port is taken, none is free, or the address is not this machine's.
    """
    if port is not None and not _is_free(host, port):
        raise InputError(f"port {port} on {host} is taken; choose another one or leave --port away")
    chosen = port or next((n for n in range(first, first + N_PORTS) if _is_free(host, n)), None)
    if chosen is None:
        raise InputError(f"no port from {first} to {first + N_PORTS} is free; give one with --port")
    return chosen


def _tell(console: Console, plan: UiPlan, page: str, host: str) -> None:
    console.result(f"MLflow shows this project's runs at {plan.address}{page}")
    if is_loopback(host):
        console.say(f"(a browser that does not find {BROWSER_NAME} finds {plan.server}{page})")
    else:
        console.say(
            "It asks for the user 'admin' and its password, unencrypted: put a proxy with TLS before it."
        )
    console.result("Ctrl-C stops it.")
    console.document({"command": "ui", **plan.to_dict(), "url": f"{plan.address}{page}", "dry_run": False})


def _is_free(host: str, port: int) -> bool:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
                raise InputError(f"{host!r} is no address of this machine; correct --host") from None
            return False
    return True


def interrupt(number: int, frame: object) -> NoReturn:
    """Turn a polite request to end into Ctrl-C, so that the server is stopped on either."""
    raise KeyboardInterrupt


def _is_up(server: "subprocess.Popen[bytes]", url: str) -> bool:
    """Wait until the server answers; return whether it does."""
    deadline = time.monotonic() + START_LIMIT_S
    health = f"{url}health"
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
