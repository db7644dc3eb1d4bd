"""What a command does and with what: a case, a profile, folders, processes."""

import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from studies.paths import ProjectPaths
from studies.profile import Profile
from studies.results.provenance import SCHEMA, Provenance, file_digest
from studies.results.saved import plain
from studies.words.console import Console

if TYPE_CHECKING:
    from simulation.case import Case


class StageError(RuntimeError):
    """A stage failed for a reason that is not the user's input."""


@dataclass(frozen=True)
class Task:
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
        max_hours: no simulation and no trial begins later than this after the command did; None sets no
            limit. [h]
        began_s: when the command began, on the monotonic clock. [s]
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
    began_s: float = field(default_factory=time.monotonic)

    @property
    def until_s(self) -> float:
        """When nothing begins any more, on the monotonic clock; infinite for never. [s]."""
        return math.inf if self.max_hours is None else self.began_s + 3600.0 * self.max_hours

    def provenance(self, *, kind: str, **more: Any) -> dict[str, Any]:
        """Return what makes a result of this study again, as JSON values.

        Args:
            kind: what the result is.
            more: what this kind needs beyond case and profile.
        """
        # `studies status` reads results without the modules that simulate.
        from simulation.case_reading import read_experiments
        from simulation.sheets import without_sheet

        case, paths = self.case, self.paths
        folder, files = case.path.parent, {case.path: None}
        for declared in (one.file for one in read_experiments(case.path)):
            names = [one.file for one in declared.inputs] + [one.file for one in declared.outputs if one.file]
            data = folder / declared.data
            recordings = (data / without_sheet(name)[0] for name in names)
            files |= dict.fromkeys([folder / declared.fmu, *recordings])
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
