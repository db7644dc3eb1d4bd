"""The tables and figures that are repeated: by name, what each needs, how one is made, kept and shown."""

import importlib
import logging
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from simulation.errors import InputError, MachineError
from simulation.record_file import read_json, write_json
from studies.paper import ITEMS
from studies.paper.plan import Plan
from studies.paths import size_name
from studies.reporting.drawing import Figure, write_picture
from studies.results.outcome import digest_of
from studies.results.saved import plain, rebuilt
from studies.task import Task
from studies.tracking.origin import versions
from studies.words.wording import difference_unit

RESULT = "result.json"

SCHEMA = 1
Size = TypeVar("Size")
Cell = float | int | str | None


_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Shown:
    """What an item shows.

    Args:
        title: what the table holds.
        columns: headings of the table.
        rows: its cells; None where there is no number.
        picture: file of the picture; empty for a table without one.
        figure: the picture.
        footnote: small print of the picture.
        more: further results as JSON values.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    picture: str = ""
    figure: Figure | None = None
    footnote: str = ""
    more: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path, command: str) -> list[Path]:
        """Write table and numbers, draw the picture, and return the files, the JSON file first."""
        table = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        write_json(folder / RESULT, {"command": command, "title": self.title, "table": table, **self.more})
        if self.figure is None:
            return [folder / RESULT]
        try:
            picture = write_picture(self.figure, folder / self.picture, footnote=self.footnote)
        except MachineError as error:
            _LOG.warning("%s: %s; its numbers are complete", self.picture, error)
            return [folder / RESULT]
        return [folder / RESULT, picture]


def module_of(item: str) -> Any:
    """Return the module of an item: its `run` takes a Plan and returns what is Shown.

    A module of `DRAWN` also has `SIZE`, the dataclass of a training-set size, and `shown`, which draws these.
    """
    return importlib.import_module(f"studies.paper.{item}")


def make(plan: Plan, item: str) -> tuple[Shown, list[Path]]:
    """Make an item, write its files, and log it to MLflow.

    Args:
        plan: what is repeated, and with how much.
        item: which one.

    Returns:
        What it shows, and its files, the JSON file first.
    """
    from studies.tracking.runs import log_stage

    started_s, task = time.time(), plan.task
    with task.console.stage(item, ITEMS[item]):
        shown: Shown = module_of(item).run(plan)
        files = shown.write(plan.folder(item), plan.command(item))
    log_stage(
        task,
        "paper",
        f"paper {item}",
        key=digest_of({"item": item, "result": files[0].read_text(encoding="utf-8")}),
        params={"item": item, "budget": plan.budget.name},
        figures=files[1:],
        artifacts=files[:1],
        wall_s=time.time() - started_s,
        note=shown.title,
    )
    return shown, files


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


def origin_of(plan: Plan, task: Task, item: str) -> Origin:
    """Return where the sizes of an item come from.

    Args:
        plan: what is repeated.
        task: the study that was tuned or calibrated.
        item: name of the item.
    """
    data, case = task.profile.data, task.case
    return Origin(
        command=plan.command(item),
        case=case.name,
        case_sha256=case.digest,
        label=plan.task.label,
        note=case.note,
        budget=plan.budget.name,
        profile=task.profile.name,
        seed=task.profile.seed,
        window_d=case.window_d,
        unit=difference_unit(case.outputs[0].unit),
        n_validation=data.n_validation,
        n_test=data.n_test,
        versions=versions(),
    )


def write_size(folder: Path, origin: Origin, n_train: int, size: Any) -> None:
    """Write what was found of one training-set size, a dataclass."""
    content = {"schema": SCHEMA, "origin": plain(origin), "size": plain(size)}
    write_json(folder / f"{size_name(n_train)}.json", content)


def size_files(folder: Path) -> list[Path]:
    """Return the files of a folder, the smallest size first."""
    return sorted(folder.glob("n[0-9]*.json"))


def read_sizes(folder: Path, kind: type[Size]) -> tuple[Origin, tuple[Size, ...]]:
    """Read what was found of all sizes of a folder, the smallest size first.

    Args:
        folder: with files of at least one size.
        kind: the dataclass that one file holds.

    Raises:
        InputError: there is no file, one cannot be read, or they belong to different studies.
    """
    origins, sizes = list[Origin](), list[Size]()
    for file in size_files(folder):
        content = read_json(file)
        if content is None or content.get("schema") != SCHEMA:
            raise InputError(f"{file} holds no results of this item as this version writes them")
        origins.append(rebuilt(Origin, content.get("origin"), str(file)))
        sizes.append(rebuilt(kind, content.get("size"), str(file)))
        if origins[-1] != origins[0]:
            raise InputError(f"{file} belongs to other studies than the smallest size; remove one of them")
    if not sizes:
        raise InputError(f"{folder} holds no results of this item; they are files such as n0032.json")
    return origins[0], tuple(sizes)
