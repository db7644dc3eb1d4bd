"""What a figure or table is drawn from again: one JSON file per training-set size, without the recording."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

from simulation.errors import InputError
from studies.paths import size_name
from studies.report.wording import difference_unit
from studies.stages.pipeline import read_json, write_json
from studies.tracking.origin import versions

if TYPE_CHECKING:
    from studies.paper.plan import Plan
    from studies.stages.pipeline import Study

SCHEMA = 1


@dataclass(frozen=True)
class Origin:
    """Where the sizes come from; the same for all of them.

    Args:
        command: the command that makes them.
        case: name of the case.
        case_sha256: digest of the case.
        label: what the results are named after.
        note: what a reader of the case must know.
        budget: the budget of the command.
        profile: name of the profile.
        seed: seed of the studies.
        window_d: first and last day. [d]
        unit: unit of the errors.
        n_validation: simulations that choose.
        n_test: simulations that only judge.
        versions: of the programs, by name.
    """

    command: str
    case: str
    case_sha256: str
    label: str
    note: str
    budget: str
    profile: str
    seed: int
    window_d: tuple[float, float]
    unit: str
    n_validation: int
    n_test: int
    versions: dict[str, str]


class Size(Protocol):
    """What is kept of one training-set size: a dataclass of JSON values."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def n_train(self) -> int:
        """Training-set size."""


AnySize = TypeVar("AnySize", bound=Size)
Content = TypeVar("Content")


def origin_of(plan: "Plan", study: "Study", item: str) -> Origin:
    """Return where the sizes of an item come from.

    Args:
        plan: what is repeated.
        study: the study that was tuned or calibrated.
        item: name of the item.
    """
    data, case = study.profile.data, study.case
    return Origin(
        command=plan.command(item),
        case=case.name,
        case_sha256=case.digest,
        label=plan.study.label,
        note=case.note,
        budget=plan.budget.name,
        profile=study.profile.name,
        seed=study.profile.seed,
        window_d=case.window_d,
        unit=difference_unit(case.outputs[0].unit),
        n_validation=data.n_validation,
        n_test=data.n_test,
        versions=versions(),
    )


def write_sizes(folder: Path, origin: Origin, sizes: Sequence[Size]) -> tuple[Path, ...]:
    """Write one file per size, and return them."""
    files = []
    for size in sizes:
        files.append(folder / f"{size_name(size.n_train)}.json")
        write_json(files[-1], {"schema": SCHEMA, "origin": asdict(origin), "size": asdict(size)})
    return tuple(files)


def read_sizes(
    folder: Path, what: str, size_of: Callable[[dict[str, Any]], AnySize]
) -> tuple[Origin, tuple[AnySize, ...]]:
    """Read all sizes of a folder, the smallest first.

    Args:
        folder: where the files lie.
        what: what they hold, for messages.
        size_of: rebuilds a size from its JSON values.

    Raises:
        InputError: there is none, one cannot be read, or they belong to different studies.
    """
    found = [(file, *_read(file, what, size_of)) for file in sorted(folder.glob("n[0-9]*.json"))]
    if not found:
        raise InputError(f"{folder} holds no {what}; name a folder with files such as n0032.json")
    first = found[0][1]
    for file, origin, _ in found:
        if origin != first:
            raise InputError(f"{file} belongs to other studies than {found[0][0].name}; remove one of them")
    return first, tuple(sorted((size for _, _, size in found), key=lambda size: size.n_train))


def first_origin(folder: Path) -> Origin | None:
    """Return where the sizes of a folder come from, None where it holds none.

    Raises:
        InputError: the file cannot be read.
    """
    file = min(folder.glob("n[0-9]*.json"), default=None)
    return None if file is None else _read(file, "sizes", dict)[0]


def _read(file: Path, what: str, size_of: Callable[[dict[str, Any]], Content]) -> tuple[Origin, Content]:
    content = read_json(file)
    if content is None or content.get("schema") != SCHEMA:
        raise InputError(f"{file} holds no {what} as this version writes them")
    try:
        origin: Mapping[str, Any] = content["origin"]
        return Origin(**{**origin, "window_d": tuple(origin["window_d"])}), size_of(content["size"])
    except (KeyError, TypeError) as error:
        raise InputError(f"{file} holds no {what} as this version writes them: {error}") from None
