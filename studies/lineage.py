"""Where a result comes from and what was made of it.

The way up: calibrated parameters, surrogate, trial, study, rows, case, FMU and recordings. Each step is
looked at where it lies now.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from studies.paths import ProjectPaths
from studies.reproduction.ancestry import Ancestry, State


@dataclass(frozen=True)
class Step:
    """One thing on the way from a measurement to calibrated parameters.

    Args:
        depth: how many steps it is away.
        kind: what it is: calibration, sensitivity, model, trial, study, rows, case, FMU or recording.
        name: what it is called.
        digest: sha256 of its content, as it was recorded.
        place: where it lies, relative to the project where it lies in it.
        state: whether it is still there and what it was.
    """

    depth: int
    kind: str
    name: str
    digest: str
    place: str
    state: State

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class Lineage:
    """The ways up and down from one thing.

    Args:
        thing: the thing itself.
        made_from: what it was made from, depth first.
        made_of_it: what was made of it, depth first.
    """

    thing: Step
    made_from: tuple[Step, ...]
    made_of_it: tuple[Step, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "thing": self.thing.to_dict(),
            "made_from": [step.to_dict() for step in self.made_from],
            "made_of_it": [step.to_dict() for step in self.made_of_it],
        }


def lineage_of(paths: ProjectPaths, name: str) -> Lineage:
    """Return where something comes from and what was made of it.

    Args:
        paths: the project.
        name: a study, a trial, a stage (office-quick/calibrate-n0064), a champion's folder, a file of the
            project, or the first digits of a digest.

    Raises:
        InputError: nothing is known of it.
    """
    ancestry = Ancestry(paths)
    key = ancestry.find(name)
    node = ancestry.nodes

    def down(one: str) -> Sequence[str]:
        return ancestry.children.get(one, [])

    def up(one: str) -> Sequence[str]:
        return node[one].parents

    (thing,) = _steps(ancestry, [key], 0, lambda one: (), set())
    return Lineage(
        thing=thing,
        made_from=tuple(_steps(ancestry, up(key), 1, up, set())),
        made_of_it=tuple(_steps(ancestry, down(key), 1, down, set())),
    )


def _steps(
    ancestry: Ancestry,
    keys: Sequence[str],
    depth: int,
    onward: Callable[[str], Sequence[str]],
    seen: set[str],
) -> Iterator[Step]:
    for key in keys:
        if key not in seen:
            seen.add(key)
            node = ancestry.nodes[key]
            yield Step(depth, node.kind, node.name, node.digest, node.place, ancestry.state(key))
            yield from _steps(ancestry, onward(key), depth + 1, onward, seen)
