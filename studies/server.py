"""The MLflow server that a project's runs are sent to: named by whom, and allowed by whom.

A project's folder may be a stranger's: what it names is used once the user has allowed it.
"""

import os
import re
import shlex
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from simulation.errors import InputError
from simulation.foreign_file import Limit, parse_toml, read_text
from simulation.foreign_text import quoted
from simulation.whole_file import whole_file

TRACKING_VARIABLE, REGISTRY_VARIABLE, EXPERIMENT_VARIABLE = (
    "MLFLOW_TRACKING_URI",
    "MLFLOW_REGISTRY_URI",
    "MLFLOW_EXPERIMENT_NAME",
)
LOCAL = "local"
"""In place of a server: the project's own store alone."""
ALLOWED = "studies/servers"
"""File in the user's folder of settings: a URL per line that projects may send runs to."""
_FORMS = "http(s)://..., sqlite:////absolute/path, databricks or databricks://PROFILE"
_SETTINGS = Limit("a file studies.toml", 1)
_TEXTS = ("project", "tracking", "registry", "experiment")


@dataclass(frozen=True)
class Server:
    """Where runs are sent to.

    Args:
        uri: MLflow's tracking URI.
        registry: URI of the model registry.
        experiment: name of the experiment of all labels, or what stands before each label if it ends with
            "/"; "" for the label alone.
        tags: what every run gets there.
    """

    uri: str
    registry: str
    experiment: str = ""
    tags: tuple[tuple[str, str], ...] = ()

    @property
    def is_remote(self) -> bool:
        """Whether it has pages of its own, at its address."""
        return self.uri.startswith(("http:", "https:"))


def settings(file: Path) -> dict[str, Any]:
    """Return what a project's `studies.toml` says; nothing where there is none.

    Raises:
        InputError: it is no TOML, or a value is no text.
    """
    if not file.is_file():
        return {}
    found = parse_toml(read_text(file, _SETTINGS), str(file))
    tags = found.get("tags", {})
    texts = {name: found[name] for name in _TEXTS if name in found}
    texts |= (
        {f"tags.{name}": value for name, value in tags.items()} if isinstance(tags, dict) else {"tags": tags}
    )
    for name, value in texts.items():
        if not isinstance(value, str) or not value.isprintable():
            raise InputError(f'{file}: {name} is {quoted(value)}; write a text, as {name} = "..."')
    return found


def give_identity(file: Path) -> None:
    """Write an identity into a project's `studies.toml`, unless it has one; a copy of the file keeps it."""
    if "project" not in settings(file):
        text = file.read_text(encoding="utf-8-sig")
        with whole_file(file) as stream:
            stream.write(f'project = "{uuid.uuid4().hex}"\n{text}'.encode())


def choose_server(option: str | None, file: Path, own: str) -> Server | None:
    """Return the server that runs are sent to; None for the project's own store alone.

    The option comes first, then MLflow's variables as this process was started with them: `set_tracking_uri`
    of a script changes them later, and means the script's own runs. The project's file comes last.

    Args:
        option: what `--tracking` says.
        file: the project's `studies.toml`.
        own: URI of the project's own store.

    Raises:
        InputError: it is no address of a server, holds a password, or is not allowed.
    """
    said, begun = settings(file), _environment_at_start()
    given, where = option or begun.get(TRACKING_VARIABLE), "--tracking" if option else f"${TRACKING_VARIABLE}"
    registry = begun.get(REGISTRY_VARIABLE, "")
    if not given and "tracking" in said:
        given, registry, where = said["tracking"], registry or said.get("registry", ""), f"{file}: tracking"
        for one in filter(None, (given, said.get("registry", ""))):
            if one != LOCAL:
                _check_allowed(read_server(one, where), file)
    if not given or given == LOCAL:
        return None
    uri = read_server(given, where)
    if uri == own:
        return None
    experiment = begun.get(EXPERIMENT_VARIABLE) or said.get("experiment", "")
    tags = tuple(sorted(said.get("tags", {}).items()))
    return Server(uri, read_server(registry, "the registry") if registry else uri, experiment, tags)


def read_server(given: str, where: str) -> str:
    """Return the address of a server as MLflow reads it.

    Args:
        given: what the user wrote; messages do not show it where it may hold a password.
        where: who says so.

    Raises:
        InputError: it is none, or it holds a password.
    """
    try:
        parts = urlsplit(given)
        _ = parts.port
    except ValueError:
        parts = urlsplit("")
    if "@" in given or parts.query or parts.fragment:
        raise InputError(
            f"{where} may hold a password, which records would show; write the address alone, the name into "
            "$MLFLOW_TRACKING_USERNAME and the password into $MLFLOW_TRACKING_PASSWORD (or a token into "
            "$MLFLOW_TRACKING_TOKEN)"
        )
    is_plain = re.fullmatch(r"[\w:/.,~%+-]+|sqlite:///[^'\"\\]+", given) and given.isprintable()
    if is_plain and parts.scheme in ("http", "https") and parts.hostname:
        return given.rstrip("/")
    if is_plain and given.startswith("sqlite:///") and len(given) > len("sqlite:///"):
        return f"sqlite:///{Path(given.removeprefix('sqlite:///')).absolute().as_posix()}"
    if is_plain and (given == "databricks" or parts.scheme == "databricks"):
        return given
    raise InputError(
        f"{where} is {quoted(given)}, to which no runs can be sent; write {_FORMS}, or --tracking {LOCAL} "
        "to keep them in the project"
    )


def _check_allowed(uri: str, file: Path) -> None:
    """Refuse a server that the user has not allowed outside of the project.

    Raises:
        InputError: it is not allowed.
    """
    home = Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config").expanduser()
    allowed = home / ALLOWED
    known = allowed.read_text(encoding="utf-8").split("\n") if allowed.is_file() else []
    if uri not in {line.strip().rstrip("/") for line in known}:
        write = f"mkdir -p {shlex.quote(str(allowed.parent))} && echo {shlex.quote(uri)} >> "
        raise InputError(
            f"{file} sends runs to {uri}, which you have not allowed; allow it with: {write}"
            f"{shlex.quote(str(allowed))}, or keep runs in the project with --tracking {LOCAL}"
        )


@cache
def _environment_at_start() -> Mapping[str, str]:
    try:
        content = Path("/proc/self/environ").read_bytes().decode(errors="replace")
    except OSError:
        return {}
    parts = [one.partition("=") for one in content.split("\0")]
    return {name: value for name, is_set, value in parts if is_set}
