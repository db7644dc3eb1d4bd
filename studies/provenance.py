"""What an MLflow run says of how its result was made, read into frozen types before anything follows it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from simulation.errors import InputError
from simulation.foreign_text import quoted, shortened
from studies.calibration.adaptive import Adaptive
from studies.profile import Profile, in_one_line
from studies.recipe import SCHEMA
from studies.tuning.declaration import Declaration


@dataclass(frozen=True)
class NamedCase:
    """The case of a recipe: where it lay, and the SHA-256 of its file, its model and its measurement."""

    place: str
    sha256: str
    digest: str
    measurement_digest: str


@dataclass(frozen=True)
class FollowedRecipe:
    """What is followed of a recipe.

    Args:
        kind: what it makes.
        label: the study's label.
        command: the command line that made it.
        case: the case.
        window_d: the window. [d]
        profile: the budget.
        settings: how an adaptive calibration searched.
        n_train: size of a calibration's training set.
        surrogate: run of a calibration's surrogate, by "run_id".
    """

    kind: str
    label: str
    command: str
    case: NamedCase
    window_d: tuple[float, float]
    profile: Profile
    settings: Adaptive | None = None
    n_train: int = 0
    surrogate: dict[str, str | int] = field(default_factory=dict)


@dataclass(frozen=True)
class Provenance:
    """What an MLflow run says of how it was made.

    Args:
        recipe: what is done.
        environment: packages, code and machine.
        declaration: a trial's study.
        params: a trial's hyperparameters.
        seed: seed of a trial's training.
    """

    recipe: FollowedRecipe
    environment: dict[str, str] = field(default_factory=dict)
    declaration: Declaration | None = None
    params: dict[str, int | float | str | bool] = field(default_factory=dict)
    seed: Annotated[int, Field(ge=0)] = 0

    @property
    def n_threads(self) -> int | None:
        """Threads of the linear algebra, on which last digits depend; None where that is not known."""
        noted = self.environment.get("n_threads", "1")
        return int(noted) if noted.isdecimal() and len(noted) < len("10000") else None


_READER = TypeAdapter(Provenance)
NEEDED = {"training": "declaration", "calibration": "surrogate", "adaptive": "settings"}
"""What can be made again, and what must be known for it."""


def provenance_of(record: Mapping[str, Any], owner: str) -> Provenance:
    """Read what a run says of how it was made; behind this nothing of its form is checked again.

    Args:
        record: the record as it was kept.
        owner: what it belongs to, for the message.

    Raises:
        InputError: it says nothing, is damaged, or is of another version.
    """
    recipe = record.get("recipe")
    if not recipe:
        raise InputError(f"{owner} was recorded without a recipe; make it again with this version")
    kind, schema = (recipe.get("kind"), recipe.get("schema")) if isinstance(recipe, dict) else (None, None)
    if schema != SCHEMA or kind not in [*NEEDED]:  # which may be anything
        raise InputError(
            f"{owner} is a {quoted(kind)} of schema {quoted(schema)}, which this version cannot make again"
        )
    try:
        made = _READER.validate_python(record)
        if made.declaration is not None:
            made.declaration.config(made.params)
    except ValueError as error:
        said = in_one_line(error) if isinstance(error, ValidationError) else shortened(str(error))
        raise InputError(f"{owner}: provenance.json: {said}; use the version that wrote it") from None
    needed = NEEDED[kind]
    if not getattr(made.recipe, needed, None) and getattr(made, needed, None) is None:
        raise InputError(f"{owner}: provenance.json: {needed} is missing; make it again with this version")
    return made
