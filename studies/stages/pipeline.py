"""Stages with a memory: a stage whose inputs have a known digest and whose files exist is finished.

A stage leaves `<stage>.json`: its result, and what made it. Arrays of the result lie beside it in
`<stage>.npz`. The JSON file is written last and in one step: an interruption leaves a finished stage or none.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from simulation.errors import InputError
from simulation.file_lock import FileLock
from simulation.record_file import write_json
from simulation.write_gate import check_written
from studies.results.outcome import Outcome, digest_of, read_manifest, read_outcome
from studies.results.saved import arrays_of, plain, write_arrays
from studies.task import Task
from studies.tracking.origin import environment

T = TypeVar("T")


@dataclass(frozen=True)
class Stage(Generic[T]):
    """A stage of a study, which is finished once its file `<name>.json` lies in the results folder.

    Args:
        task: the task.
        name: the stage's name.
        what: what is done, for the user.
        inputs: all that decides the result, as JSON values.
        kind: type of the result.
        made: what makes it again beyond case and profile, see `Task.provenance`; None where nothing does.
    """

    task: Task
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
        return self.task.results / f"{self.name}.json"

    def once(
        self,
        work: Callable[[], T],
        *,
        again: bool = False,
        files: Sequence[Path] = (),
        log: Callable[[Task, Outcome[T]], None] | None = None,
        is_kept: Callable[[T], bool] = lambda result: True,
    ) -> Outcome[T]:
        """Return what the stage came to before, else do its work, write the result, and its run in MLflow.

        Args:
            work: does the work and returns the result.
            again: do it though it is finished; the new result replaces the old one when it is whole.
            files: must exist as the work leaves them for the stage to count as finished.
            log: writes the run in MLflow, once the result is stored; if it fails, the next command does.
            is_kept: whether it counts as finished with a result.
        """
        task, began = self.task, time.perf_counter()
        before = self._finished(again=again)
        if before is not None:
            self._log(log, before)
            return before
        with task.console.stage(self.name, self.what):
            result = work()
            outcome = Outcome(
                stage=self.name,
                result=result,
                digest=self.digest,
                inputs=self.inputs,
                wall_s=time.perf_counter() - began,
                finished=datetime.now(UTC).isoformat(timespec="seconds"),
                provenance=task.provenance(**self.made) if self.made else {},
                file=self.file,
            )
            if not is_kept(result):
                return replace(outcome, file=None)
            self._store(outcome, files, log)
        return outcome

    def _store(
        self, outcome: Outcome[T], files: Sequence[Path], log: Callable[[Task, Outcome[T]], None] | None
    ) -> None:
        """Write a result and its run in MLflow; one command at a time does so."""
        task, result = self.task, outcome.result
        with FileLock(self._lock):
            new = self.file.with_suffix(".new.npz")
            if arrays := arrays_of(result):
                files = [*files, self.file.with_suffix(".npz")]
                write_arrays(new, arrays)
            # From here on the former result is none: the two files of a result belong together.
            self.file.unlink(missing_ok=True)
            if arrays:
                new.replace(files[-1])
            manifest = {
                "stage": self.name,
                "digest": self.digest,
                "case_file": task.paths.recorded(task.case.path),
                "inputs": self.inputs,
                "files": {task.paths.recorded(made): made.stat().st_size for made in files},
                "seed": task.profile.seed,
                "wall_s": outcome.wall_s,
                "finished": outcome.finished,
                "environment": environment(),
                "provenance": outcome.provenance,
                "result": plain(result),
            }
            if log is not None:
                self._unlogged.touch()
            # It says that the stage is finished.
            write_json(self.file, manifest)
            self._begun_again.unlink(missing_ok=True)
        self._log(log, outcome)

    @property
    def is_anew(self) -> bool:
        """Whether doing it again would begin from nothing: it is finished, and was not begun again before."""
        return self.file.is_file() and not self._begun_again.is_file()

    @property
    def _begun_again(self) -> Path:
        return self.file.with_suffix(".again")

    @property
    def _lock(self) -> Path:
        return self.file.with_name(f".{self.name}.lock")

    @property
    def _unlogged(self) -> Path:
        return self.file.with_suffix(".unlogged")

    def _log(self, log: Callable[[Task, Outcome[T]], None] | None, outcome: Outcome[T]) -> None:
        """Write the run in MLflow, unless that was done."""
        if log is not None and self._unlogged.is_file():
            with FileLock(self._lock):  # another command may just write it
                if self._unlogged.is_file():
                    log(self.task, outcome)
                    self._unlogged.unlink(missing_ok=True)

    def _finished(self, *, again: bool) -> Outcome[T] | None:
        """Return what the stage came to before, and say so; None where it has to be done."""
        check_written(self.file)
        if again:
            if self.file.is_file():
                self._begun_again.touch()
            return None
        root = self.task.paths.root
        try:
            manifest = read_manifest(self.task.results, self.name) or {}
            if manifest.get("digest") != self.digest:
                return None
            left = {root / name: size for name, size in manifest.get("files", {}).items()}
            if not all(file.is_file() and file.stat().st_size == size for file, size in left.items()):
                return None
            outcome = read_outcome(self.task.results, self.name, self.kind)
        except InputError as unreadable:
            self.task.console.warn(f"{unreadable}; {self.name} is done again")
            return None
        if outcome is None or (self.task.retry_failed and getattr(outcome.result, "has_failures", False)):
            self.file.unlink(missing_ok=True)
            return None
        self.task.console.say(f"{self.name}: finished before")
        return outcome
