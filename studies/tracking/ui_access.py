"""Who may use a server on a network: MLflow's own passwords, kept beside the project's store."""

import getpass
import importlib.util
import os
import secrets
import socket
import sys
from pathlib import Path

from simulation.errors import InputError
from studies.paths import ProjectPaths

PASSWORD_VARIABLE = "MLFLOW_AUTH_ADMIN_PASSWORD"
N_LEAST_CHARACTERS = 12  # MLflow takes no shorter one
LOOPBACK = "127.0.0.1"
BROWSER_NAME = "studies.localhost"
"""A name that browsers look up on their own machine. MLflow's page opens its assistant at the usual names."""

_ADMIN = "admin"


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach a server on that address."""
    return host in ("localhost", "::1") or host.startswith("127.")


def loopback_environment(port: int) -> dict[str, str]:
    """Return what lets a browser on this machine in, under each of its names."""
    return {
        "MLFLOW_SERVER_ALLOWED_HOSTS": f"localhost:{port},{LOOPBACK}:{port},{BROWSER_NAME}:{port}",
        "MLFLOW_SERVER_CORS_ALLOWED_ORIGINS": f"http://{BROWSER_NAME}:{port}",
    }


def network_environment(paths: ProjectPaths, host: str, port: int, *, ask: bool = True) -> dict[str, str]:
    """Return what makes MLflow ask for a password, and make the files that it needs.

    Args:
        paths: the project; users and keys are kept in `mlruns/access`.
        host: address that the server listens on.
        port: its port.
        ask: whether to make files and ask for what is missing; without it nothing is touched.

    Raises:
        InputError: MLflow's password protection is not installed, or there is no password.
    """
    if importlib.util.find_spec("flask_wtf") is None:
        raise InputError(
            f"a server on {host} needs MLflow's password protection, which is not installed; "
            "type: pip install 'pelsvae-studies[server]' (or 'mlflow[auth]'), or leave --host away"
        )
    folder = paths.mlruns / "access"
    users, settings, key = folder / "users.db", folder / "settings.ini", folder / "secret.key"
    found = {
        "MLFLOW_AUTH_CONFIG_PATH": str(settings),
        "MLFLOW_SERVER_ALLOWED_HOSTS": os.environ.get("MLFLOW_SERVER_ALLOWED_HOSTS") or _names(host, port),
    }
    if not ask:
        return {**found, "MLFLOW_FLASK_SERVER_SECRET_KEY": "***"}
    password = os.environ.get(PASSWORD_VARIABLE, "")
    if not users.is_file():
        password = password or _asked_password(host)
        if len(password) < N_LEAST_CHARACTERS:
            raise InputError(
                f"the password of {_ADMIN!r} has {len(password)} characters; give one of at least "
                f"{N_LEAST_CHARACTERS} in ${PASSWORD_VARIABLE}"
            )
        found[PASSWORD_VARIABLE] = password
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.chmod(0o700)
    settings.write_text(
        "[mlflow]\n"
        "default_permission = READ\n"
        f"database_uri = sqlite:///{users.resolve().as_posix()}\n"
        f"admin_username = {_ADMIN}\n"
        "authorization_function = mlflow.server.auth:authenticate_request_basic_auth\n",
        encoding="utf-8",
    )
    if not key.is_file():
        _write_secret(key, secrets.token_hex(32))
    return {**found, "MLFLOW_FLASK_SERVER_SECRET_KEY": key.read_text(encoding="ascii").strip()}


def shown(environment: dict[str, str]) -> dict[str, str]:
    """Return variables as they may be told: secrets as stars."""
    secret = (PASSWORD_VARIABLE, "MLFLOW_FLASK_SERVER_SECRET_KEY")
    return {name: "***" if name in secret else value for name, value in environment.items()}


def _asked_password(host: str) -> str:
    if not sys.stdin.isatty():
        raise InputError(
            f"a server on {host} needs a password for its user {_ADMIN!r}; give one of at least "
            f"{N_LEAST_CHARACTERS} characters in ${PASSWORD_VARIABLE}"
        )
    return getpass.getpass(f"password for {_ADMIN!r}, at least {N_LEAST_CHARACTERS} characters: ")


def _names(host: str, port: int) -> str:
    """Return the names under which a network's machines may ask for this server."""
    named = {host, socket.gethostname(), socket.getfqdn(), "localhost", LOOPBACK} - {"0.0.0.0", "::"}
    # Addresses of private networks; a public name or address is the user's to add in the variable.
    private = ["192.168.*", "10.*", *(f"172.{n}.*" for n in range(16, 32))]
    return ",".join([*sorted(f"{name}:{port}" for name in named), *private])


def _write_secret(file: Path, text: str) -> None:
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as stream:
        stream.write(text + "\n")
