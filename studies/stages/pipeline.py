"""Stages with a memory: a stage whose inputs have a known digest and whose files exist is finished.

A stage leaves `<stage>.json`: its result, and what made it. Arrays of the result lie beside it in
`<stage>.npz`. The JSON file is written last and in one step: an interruption leaves a finished stage or none.
"""

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from simulation.errors import InputError
from simulation.write_gate import check_written
from studies.console import Console
from studies.paths import ProjectPaths
from studies.profile import Profile
from studies.provenance import SCHEMA, Provenance, file_digest
from studies.stages.saved import arrays_of, plain, read_arrays, rebuilt, write_arrays
from studies.stages.saved import read_json as read_json
from studies.stages.saved import write_json as write_json
from studies.tracking.origin import environment

if TYPE_CHECKING:
    from simulation.case import Case


T = TypeVar("T")


class StageError(RuntimeError):
    """A stage failed for a reason that is not the user's input."""


@dataclass(frozen=True)
class Study:
    """A case x a profile, with all that a stage needs to know.

    Args:
        case: the physics.
        profile: the budget.
        paths: where everything lies.
        console: shows progress and results.
        n_jobs: processes for simulations and trainings.
        label: what a user sees of case, profile, window and seed.
        command: the end of the command line that names this study, for messages.
        typed: the whole command line, as records and the report give it.
        retry_failed: whether failed simulations are retried.
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

    def provenance(self, *, kind: str, **more: Any) -> dict[str, Any]:
        """Return what makes a result of this study again, as JSON values.

        Args:
            kind: what the result is.
            more: what this kind needs beyond case and profile.
        """
        # `studies status` reads results without the modules that simulate.
        from simulation.case_reading import read_experiments

        case, paths = self.case, self.paths
        folder, files = case.path.parent, {case.path: None}
        for declared in (one.file for one in read_experiments(case.path)):
            names = [one.file for one in declared.inputs] + [one.file for one in declared.outputs if one.file]
            data = folder / declared.data
            files |= dict.fromkeys([folder / declared.fmu, *(data / name for name in names)])
        for one in case.experiments or (case,):
            files |= dict.fromkeys(one.named_files.files)
        made = Provenance(
            schema=SCHEMA,
            kind=kind,
            label=self.label,
            command=self.typed,
            case_file=paths.recorded(case.path),
            case_text=case.path.read_text(encoding="utf-8-sig"),
            case_digest=case.digest,
            measurement_digest=case.measurement.digest,
            files={paths.recorded(file.resolve()): file_digest(file) for file in files},
            window_d=case.window_d,
            profile=self.profile,
            **more,
        )
        return plain(made)

    @property
    def results(self) -> Path:
        """Folder of stage manifests and results."""
        return self.paths.results(self.label)


@dataclass(frozen=True, eq=False)
class Outcome(Generic[T]):
    """What a stage came to, and what made it.

    Args:
        stage: name of the stage.
        result: its result.
        digest: digest of its inputs.
        inputs: all that decided the result, as JSON values.
        reused: whether it was finished before.
        wall_s: how long it took, this time or before. [s]
        finished: when it was finished, UTC.
        provenance: what makes the result again, as JSON values; empty where nothing does.
        file: its JSON file; None where another program keeps the result.
    """

    stage: str
    result: T
    digest: str
    inputs: Mapping[str, Any] = field(default_factory=dict)
    reused: bool = False
    wall_s: float = 0.0
    finished: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    file: Path | None = None

    @property
    def name(self) -> str:
        """Name of a calibration, of which there are several: "adaptive" or "n0064"."""
        return self.stage.partition("-")[2]

    def to_dict(self, paths: ProjectPaths) -> dict[str, Any]:
        """Return the outcome as JSON values; places in it are relative to the project's folder."""
        head = {"stage": self.stage, "digest": self.digest, "finished_before": self.reused}
        file = {} if self.file is None else {"file": paths.show(self.file)}
        return {**head, "wall_s": round(self.wall_s, 3), **plain(self.result), **file}


def digest_of(inputs: Mapping[str, Any]) -> str:
    """Return the sha256 of JSON values; the order of keys does not matter."""
    text = json.dumps(inputs, sort_keys=True, allow_nan=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def read_outcome(folder: Path, stage: str, kind: type[T]) -> Outcome[T] | None:
    """Read what a finished stage has left; None where there is nothing.

    Args:
        folder: the results of a label.
        stage: name of the stage.
        kind: type of its result.

    Raises:
        InputError: it cannot be read by this version, or its arrays are damaged.
    """
    file = folder / f"{stage}.json"
    manifest, arrays = read_json(file), file.with_suffix(".npz")
    if manifest is None or "result" not in manifest:  # which an earlier version wrote
        return None
    kept = read_arrays(arrays) if arrays.is_file() else {}
    result = rebuilt(kind, manifest["result"], str(file), kept)
    try:
        return Outcome(
            stage=stage,
            result=result,
            digest=str(manifest["digest"]),
            inputs=dict(manifest["inputs"]),
            reused=True,
            wall_s=float(manifest["wall_s"]),
            finished=str(manifest["finished"]),
            provenance=dict(manifest.get("provenance", {})),
            file=file,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{file}: not written by this version ({error!r}); move it away") from None


@dataclass(frozen=True)
class Stage(Generic[T]):
    """A stage of a study, which is finished once its file `<name>.json` lies in the results folder.

    Args:
        study: the study.
        name: the stage's name.
        what: what is done, for the user.
        inputs: all that decides the result, as JSON values.
        kind: type of the result.
        made: what makes it again beyond case and profile, see `Study.provenance`; None where nothing does.
    """

    study: Study
    name: str
    what: str
    inputs: Mapping[str, Any]
    kind: type[T]
    made: Mapping[str, Any] | None = None

    @property
    def digest(self) -> str:
        """Digest of the inputs."""
        return digest_of(self.inputs)

    @property
    def file(self) -> Path:
        """The file that says that the stage is finished."""
        return self.study.results / f"{self.name}.json"

    def once(
        self,
        work: Callable[[], T],
        *,
        again: bool = False,
        files: Sequence[Path] = (),
        log: Callable[[Study, Outcome[T]], None] | None = None,
        is_kept: Callable[[T], bool] = lambda result: True,
    ) -> Outcome[T]:
        """Return what the stage came to before, else do its work, write the result, and its run in MLflow.

        Args:
            work: does the work and returns the result.
            again: do it though it is finished; until it is done again it counts as unfinished.
            files: must exist as the work leaves them for the stage to count as finished.
            log: writes the run in MLflow.
            is_kept: whether it counts as finished with a result.
        """
        study, began = self.study, time.perf_counter()
        before = self._finished(again=again)
        if before is not None:
            return before
        with study.console.stage(self.name, self.what):
            result = work()
            outcome = Outcome(
                stage=self.name,
                result=result,
                digest=self.digest,
                inputs=self.inputs,
                wall_s=time.perf_counter() - began,
                finished=datetime.now(UTC).isoformat(timespec="seconds"),
                provenance=study.provenance(**self.made) if self.made else {},
                file=self.file,
            )
            if not is_kept(result):
                return replace(outcome, file=None)
            if arrays := arrays_of(result):
                files = [*files, self.file.with_suffix(".npz")]
                write_arrays(files[-1], arrays)
            if log is not None:
                log(study, outcome)
            manifest = {
                "stage": self.name,
                "digest": self.digest,
                "case_file": study.paths.recorded(study.case.path),
                "inputs": self.inputs,
                "files": {study.paths.recorded(made): made.stat().st_size for made in files},
                "seed": study.profile.seed,
                "wall_s": outcome.wall_s,
                "finished": outcome.finished,
                "environment": environment(),
                "provenance": outcome.provenance,
                "result": plain(result),
            }
            # Last, as it says that the stage is finished.
            write_json(self.file, manifest)
        return outcome

    def _finished(self, *, again: bool) -> Outcome[T] | None:
        """Return what the stage came to before, and say so; None where it has to be done."""
        check_written(self.file)
        if again:
            self.file.unlink(missing_ok=True)
        root = self.study.paths.root
        try:
            manifest = read_json(self.file) or {}
        except InputError as damaged:
            self.study.console.warn(f"{damaged}; {self.name} is done again")
            return None
        if manifest.get("digest") != self.digest:
            return None
        left = {root / name: size for name, size in manifest.get("files", {}).items()}
        if not all(file.is_file() and file.stat().st_size == size for file, size in left.items()):
            return None
        outcome = None
        with suppress(InputError):  # what cannot be read is done again
            outcome = read_outcome(self.study.results, self.name, self.kind)
        if outcome is None or (self.study.retry_failed and getattr(outcome.result, "has_failures", False)):
            self.file.unlink(missing_ok=True)
            return None
        self.study.console.say(f"{self.name}: finished before")
        return outcome
