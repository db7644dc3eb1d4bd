"""Stages with a memory: a stage whose inputs have a known digest and whose files exist is finished.

Each stage leaves a manifest beside the results: digest, case file, inputs, files, seed, environment, wall
time. It is written last and in one step, so that an interruption leaves a finished stage or none.
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.foreign_file import RECORD, read_limited
from simulation.whole_file import whole_file
from studies.console import Console
from studies.paths import ProjectPaths
from studies.profile import Profile
from studies.tracking.origin import environment

if TYPE_CHECKING:
    from simulation.case import Case

Summary = dict[str, Any]

_PLACES = ("file", "files", "folder", "index", "store")
"""Keys of a summary that name files of the project."""


class StageError(RuntimeError):
    """A stage failed for a reason that is not the user's input."""


@dataclass(frozen=True)
class Study:
    """A case x a profile, with all that a stage needs to know.

    Args:
        case: the physics.
        profile: the budget.
        paths: where everything lies.
        console: tells the user.
        n_jobs: processes for simulations and trainings.
        label: what a user sees of case, profile, window and seed.
        command: the end of the command line that names this study, for messages.
        typed: the whole command line, as records and the report give it.
        retry_failed: whether simulations that failed before are asked again.
        dask: address of a Dask scheduler whose workers simulate; None for processes of this machine.
        max_hours: no trial begins later than this after the tuning did; None sets no limit. [h]
    """

    case: "Case"
    profile: Profile
    paths: ProjectPaths
    console: Console
    n_jobs: int
    label: str
    command: str
    typed: str = ""
    retry_failed: bool = False
    dask: str | None = None
    max_hours: float | None = None

    @property
    def results(self) -> Path:
        """Folder of stage manifests and results."""
        return self.paths.results(self.label)


@dataclass(frozen=True)
class Outcome:
    """What a stage came to.

    Args:
        stage: name of the stage.
        digest: digest of its inputs.
        summary: its results as JSON values.
        reused: whether it was finished before.
        wall_s: how long it took, this time or before. [s]
    """

    stage: str
    digest: str
    summary: Summary
    reused: bool
    wall_s: float

    def to_dict(self, paths: ProjectPaths) -> dict[str, Any]:
        """Return the outcome as JSON values whose paths hold in the working folder."""
        head = {"stage": self.stage, "digest": self.digest, "finished_before": self.reused}
        places = {name: _shown(self.summary[name], paths) for name in _PLACES if name in self.summary}
        return {**head, "wall_s": round(self.wall_s, 3), **self.summary, **places}


def _shown(recorded: Any, paths: ProjectPaths) -> Any:
    """Return the recorded place of a file, or several by name, as the user would type it."""
    if isinstance(recorded, Mapping):
        return {name: _shown(one, paths) for name, one in recorded.items()}
    file = paths.located(recorded)
    return recorded if file is None else paths.show(file)


def digest_of(inputs: Mapping[str, Any]) -> str:
    """Return the sha256 of JSON values; the order of keys does not matter."""
    text = json.dumps(inputs, sort_keys=True, allow_nan=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Stage:
    """A stage of a study, which is finished once its manifest `<name>.json` lies in the results folder.

    Args:
        study: the study.
        name: the stage's name.
        what: what is done, for the user.
        inputs: all that decides the result, as JSON values.
    """

    study: Study
    name: str
    what: str
    inputs: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """Digest of the inputs."""
        return digest_of(self.inputs)

    def finished(self, note: Callable[[Summary], str], *, again: bool = False) -> Outcome | None:
        """Return what the stage came to before, and say so; None where it has to be done.

        Args:
            note: what to say of a finished stage.
            again: do it though it is finished; until it is done again it counts as unfinished.
        """
        study, file = self.study, self._manifest
        if again:
            file.unlink(missing_ok=True)
        manifest = read_manifest(study.paths, file, self.digest)
        if manifest is not None and study.retry_failed and has_failed(manifest["summary"]):
            file.unlink(missing_ok=True)
            manifest = None
        if manifest is None:
            return None
        study.console.say(f"{self.name}: finished before, {note(manifest['summary'])}")
        return Outcome(self.name, self.digest, manifest["summary"], True, float(manifest["wall_s"]))

    @contextmanager
    def work(self) -> Iterator["Work"]:
        """Say when the work of the stage begins and when it has ended."""
        with self.study.console.stage(self.name, self.what):
            yield Work(self, time.time(), time.perf_counter())

    @property
    def _manifest(self) -> Path:
        return self.study.results / f"{self.name}.json"


@dataclass(frozen=True)
class Work:
    """The work of a stage that goes on.

    Args:
        stage: the stage.
        started_s: when it began. [s since 1970, UTC]
        counted_from: the same by a monotonic clock. [s]
    """

    stage: Stage
    started_s: float
    counted_from: float

    @property
    def wall_s(self) -> float:
        """How long it has taken so far. [s]."""
        return time.perf_counter() - self.counted_from

    def keep(self, summary: Summary, files: Sequence[Path] = (), *, is_finished: bool = True) -> Outcome:
        """Write the manifest, last of all and in one step, and return what the stage came to.

        Args:
            summary: its results as JSON values.
            files: must exist as they are for the stage to count as finished.
            is_finished: whether it counts as finished with this result.
        """
        stage, study, wall_s = self.stage, self.stage.study, self.wall_s
        if is_finished:
            manifest = {
                "stage": stage.name,
                "digest": stage.digest,
                "case_file": study.paths.recorded(study.case.path),
                "inputs": stage.inputs,
                "summary": summary,
                "files": {study.paths.relative(made): made.stat().st_size for made in files},
                "seed": study.profile.seed,
                "wall_s": wall_s,
                "finished": datetime.now(UTC).isoformat(timespec="seconds"),
                "environment": environment(),
            }
            write_json(stage._manifest, manifest)
        return Outcome(stage.name, stage.digest, summary, False, wall_s)


def has_failed(summary: Summary) -> bool:
    """Say whether a stage counted simulations that failed, in all or by kind, or blocks that they cost it."""
    n_failed = summary.get("n_failed", 0)
    n_failed = sum(n_failed.values()) if isinstance(n_failed, dict) else n_failed
    return bool(n_failed or summary.get("n_dropped_blocks", 0))


def read_manifest(paths: ProjectPaths, file: Path, digest: str) -> dict[str, Any] | None:
    """Return a finished stage's manifest, None where it is absent, of other inputs, or a file is gone."""
    manifest = read_json(file)
    if manifest is None or manifest.get("digest") != digest:
        return None
    for name, size in manifest.get("files", {}).items():
        made = paths.root / name
        if not made.is_file() or made.stat().st_size != size:
            return None
    return manifest


def read_json(file: Path) -> dict[str, Any] | None:
    """Return a JSON object, or None where there is no readable one."""
    try:
        content = json.loads(read_limited(file, RECORD))
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def write_json(file: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON object in one step, so that a reader sees the old file or the new one."""
    write_text(file, json.dumps(content, indent=2, allow_nan=True, default=str) + "\n")


def write_text(file: Path, text: str) -> None:
    """Write a text file in one step, safe against a crash of the machine."""
    with whole_file(file, synced=True) as stream:
        stream.write(text.encode())
