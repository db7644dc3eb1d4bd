"""What made a result, and makes it again: kept with stages and with MLflow's runs as `provenance.json`.

It holds the case file's text and names everything else by its SHA-256. So it can be followed where the
project was moved, and in another clone.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from simulation.errors import InputError
from simulation.foreign_text import quoted, shortened
from studies.paths import ProjectPaths
from studies.profile import Profile
from studies.results.declaration import Declaration
from studies.results.saved import rebuilt

if TYPE_CHECKING:
    from simulation.case import Case

SCHEMA = 3
NEEDED = {"training": "declaration", "mean": "parts", "calibration": "surrogate_run", "adaptive": "settings"}
"""What can be made again, and what must be known for it."""
FILE = "provenance.json"


@dataclass(frozen=True)
class Provenance:
    """What made a result.

    Args:
        schema: version of this form.
        kind: "training", "mean", "calibration", "adaptive", "sensitivity" or "uncertainty".
        label: the study's label.
        command: the command line that made it.
        case_file: place of the case file.
        case_text: its text.
        case_digest: SHA-256 of the model.
        measurement_digest: SHA-256 of the measurement.
        files: SHA-256 of the case file, the FMU and the recordings by place.
        window_d: the window. [d]
        profile: the budget.
        settings: how an adaptive calibration searched.
        n_train: size of a calibration's training set.
        surrogate_run: MLflow's run of a calibration's surrogate.
        declaration: a trial's study.
        params: a trial's hyperparameters.
        seed: seed of a trial's training.
        parts: MLflow's runs of the trials that a mean is made of.
        environment: packages, code and machine.
    """

    schema: int
    kind: str
    label: str
    command: str
    case_file: str
    case_text: str
    case_digest: str
    measurement_digest: str
    files: dict[str, str]
    window_d: tuple[float, float]
    profile: Profile
    settings: dict[str, Any] | None = None
    n_train: int = 0
    surrogate_run: str = ""
    declaration: Declaration | None = None
    params: dict[str, int | float | str | bool] = field(default_factory=dict)
    seed: Annotated[int, Field(ge=0)] = 0
    parts: tuple[str, ...] = ()
    environment: dict[str, str] = field(default_factory=dict)

    @property
    def n_threads(self) -> int | None:
        """Threads of the linear algebra, on which last digits depend; None where that is not known."""
        noted = self.environment.get("n_threads", "1")
        return int(noted) if noted.isdecimal() and len(noted) < len("10000") else None


def read_provenance(record: Mapping[str, Any], owner: str) -> Provenance:
    """Read what made a result; behind this nothing of its form is checked again.

    Args:
        record: the record as it was kept.
        owner: what it belongs to, for the message.

    Raises:
        InputError: it says nothing, is damaged, or is of another version.
    """
    kind, schema = record.get("kind"), record.get("schema")
    if schema != SCHEMA or kind not in [*NEEDED]:  # which may be anything
        raise InputError(
            f"{owner} is a {quoted(kind)} of schema {quoted(schema)}, which this version cannot make again"
        )
    made = rebuilt(Provenance, record, f"{owner}: {FILE}")
    try:
        if made.declaration is not None and made.kind != "mean":
            made.declaration.config(made.params)
    except ValueError as error:
        raise InputError(f"{owner}: {FILE}: {shortened(str(error))}; use the version that wrote it") from None
    if not getattr(made, NEEDED[made.kind]):
        raise InputError(f"{owner}: {FILE}: {NEEDED[made.kind]} is missing; make it again with this version")
    return made


def case_of(paths: ProjectPaths, made: Provenance, *, exactly: bool) -> "Case":
    """Return the case that something was made from.

    Args:
        paths: the project.
        made: what made it.
        exactly: whether the case file's text and the measurement have to be as they were, too.

    Raises:
        InputError: the case is not here, or is not as it was.
    """
    from simulation.case import load_case

    file, place = paths.located(made.case_file), made.case_file
    if file is None:
        raise InputError(f"the case file {quoted(place)} is not in the project; put it there")
    case = load_case(file, window_d=made.window_d)
    checks = [("its FMU or its inputs", made.case_digest, case.digest)]
    if exactly:
        checks.insert(0, ("the file itself", made.files.get(place, ""), file_digest(file)))
        checks.append(("its measurement", made.measurement_digest, case.measurement.digest))
    for what, was, now in checks:
        if was != now:
            command = quoted(made.command)
            raise InputError(
                f"{paths.show(file)}: {what} changed since {command}; restore it, or repeat that command"
            )
    return case


def file_digest(file: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
