"""The tables and figures that are repeated: by name, what each needs, and how one is made and shown."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError

if TYPE_CHECKING:
    from studies.paper.plan import Plan
    from studies.report.drawing import Figure

ITEMS = {
    "fig6": "error of every trial over the training simulations, days 8 to 16",
    "fig7": "error of the best of Fig. 6, trained again, toward the middle of the box",
    "table3": "SciPy's optimizers straight on the FMU (Tables 2 and 3)",
    "fig8": "256 starts of LS-TRF: how unique is a calibration",
    "table4": "screening and polish with the best of Fig. 6 (Table 4 and Fig. 9)",
}
ALIASES = {"table2": "table3", "fig9": "table4"}
NEEDS_FIG6 = ("fig7", "table4")
DRAWN = ("fig6", "fig7", "table4")
"""Items that can be drawn from the files of an earlier run, without the recording."""

RESULT = "result.json"

Cell = float | int | str | None


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
    figure: "Figure | None" = None
    footnote: str = ""
    more: dict[str, Any] = field(default_factory=dict)

    def write(self, folder: Path, command: str) -> list[Path]:
        """Write table and numbers, draw the picture, and return the files, the JSON file first."""
        from studies.report.drawing import write_png
        from studies.stages.pipeline import write_json

        table = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        write_json(folder / RESULT, {"command": command, "title": self.title, "table": table, **self.more})
        if self.figure is None:
            return [folder / RESULT]
        return [folder / RESULT, write_png(self.figure, folder / self.picture, footnote=self.footnote)]


def module_of(item: str) -> Any:
    """Return the module of an item: its `run` takes a Plan and returns what is Shown.

    A module of `DRAWN` also has `SIZE`, the dataclass of a training-set size, and `shown`, which draws these.
    """
    return importlib.import_module(f"studies.paper.{item}")


def chosen_items(words: Sequence[str] | None) -> tuple[str, ...]:
    """Return the items that some words mean, in the order of the paper; all of them without words.

    Raises:
        InputError: a word means no item.
    """
    if not words:
        return tuple(ITEMS)
    wanted = {ALIASES.get(word, word): word for word in words}
    for item, word in wanted.items():
        if item not in ITEMS:
            raise InputError(
                f"--only {word}: there is no such item; there are {', '.join((*ITEMS, *ALIASES))}"
            )
    return tuple(item for item in ITEMS if item in wanted)


def make(plan: "Plan", item: str) -> tuple[Shown, list[Path]]:
    """Make an item, write its files, and log it to MLflow.

    Args:
        plan: what is repeated, and with how much.
        item: which one.

    Returns:
        What it shows, and its files, the JSON file first.
    """
    import time

    from studies.stages.pipeline import digest_of
    from studies.tracking.stage_run import StageRun, log_stage

    started_s, study = time.time(), plan.study
    with study.console.stage(item, ITEMS[item]):
        shown: Shown = module_of(item).run(plan)
        files = shown.write(plan.folder(item), plan.command(item))
    log_stage(
        study.paths,
        StageRun(
            label=study.label,
            kind="paper",
            name=f"paper {item}",
            key=digest_of({"item": item, "result": files[0].read_text(encoding="utf-8")}),
            params={"item": item, "budget": plan.budget.name},
            tags={"case": study.case.name, "case_sha256": study.case.digest},
            figures=files[1:],
            artifacts=files[:1],
            started_s=started_s,
            wall_s=time.time() - started_s,
            note=shown.title,
        ),
    )
    return shown, files
