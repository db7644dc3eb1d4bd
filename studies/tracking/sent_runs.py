"""Which runs of a project lie on a server, and under which ids: read without MLflow."""

import hashlib
from dataclasses import asdict, dataclass, field
from typing import Any

from simulation.record_file import read_json, write_json
from studies.paths import ProjectPaths
from studies.server import Server

_REMEDY = "remove it, and the next command that simulates or tunes asks the server anew"


@dataclass
class SentRuns:
    """What a server has of a project.

    Args:
        uri: the server.
        experiments: ids of experiments there, by label.
        runs: by id in the project: `id` there ("" of a run that was deleted there), and what it had.
        models: by name of a registered model in the project: `name` there, and `run` in the project.
    """

    uri: str
    experiments: dict[str, str] = field(default_factory=dict)
    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    models: dict[str, dict[str, str]] = field(default_factory=dict)

    @classmethod
    def read(cls, paths: ProjectPaths, server: Server) -> "SentRuns":
        """Read what was noted; nothing where that is missing: then the server is asked.

        Raises:
            InputError: it is damaged.
        """
        found = read_json(_file(paths, server), _REMEDY) or {}
        known = {name: found[name] for name in ("experiments", "runs", "models") if name in found}
        return cls(server.uri, **{name: one for name, one in known.items() if isinstance(one, dict)})

    def write(self, paths: ProjectPaths, server: Server) -> None:
        """Note it in the project."""
        write_json(_file(paths, server), asdict(self))

    def id_of(self, run_id: str) -> str:
        """Return the id on the server of a run of the project; "" where it is not there."""
        return str(self.runs.get(run_id, {}).get("id", ""))

    def run_of(self, sent_id: str) -> str | None:
        """Return the project's run that has an id on the server."""
        return next((run for run, one in self.runs.items() if one.get("id") == sent_id), None)


def sent_runs(paths: ProjectPaths) -> SentRuns | None:
    """Return what the server of a project has of it; None where it has no server."""
    return None if paths.server is None else SentRuns.read(paths, paths.server)


def _file(paths: ProjectPaths, server: Server) -> Any:
    where = hashlib.sha256(f"{server.uri} {server.experiment}".encode()).hexdigest()[:12]
    return paths.mlruns / "sent" / f"{where}.json"
