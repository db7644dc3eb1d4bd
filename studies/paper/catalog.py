"""Which tables and figures of the paper there are, by the word for `--only`; imports nothing heavy."""

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast

from simulation.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from studies.paper.plan import Plan
    from studies.paper.result import ItemResult
    from studies.paper.size_files import Origin


@dataclass(frozen=True)
class Item:
    """One table or figure of the paper, or one that belongs beside it.

    Args:
        name: word for `--only`, name of its folder and of its module.
        title: heading on the page.
        what: what is done, for the terminal.
        needs: items that must be finished before.
        aliases: other words that mean it.
        cases: cases that it is about; none for all.
    """

    name: str
    title: str
    what: str
    needs: tuple[str, ...] = ()
    aliases: tuple[str, ...] = ()
    cases: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The words for `--only`: the name, and those that mean it as well."""
        return f"{self.name} (or {', '.join(self.aliases)})" if self.aliases else self.name

    def is_about(self, case_name: str) -> bool:
        """Say whether the item makes sense for a case."""
        return not self.cases or case_name in self.cases


ITEMS = (
    Item("fig4", "Fig. 4: training trajectories and coverage", "256 trajectories with the measurement"),
    Item("fig5", "Fig. 5: Sobol indices over time", "first and total order from Saltelli's sample"),
    Item("fig6", "Fig. 6: hyperparameters and training-set sizes", "an Optuna study per size, days 8 to 16"),
    Item(
        "fig7",
        "Fig. 7: error on narrower test sets",
        "the best of Fig. 6, trained again, on test sets of spread 0 to 1",
        needs=("fig5", "fig6"),
    ),
    Item(
        "table3",
        "Tables 2 and 3: optimizers straight on the FMU",
        "SciPy's optimizers from the guess and from many starts",
        aliases=("table2",),
    ),
    Item(
        "fig8",
        "Fig. 8: how unique is the calibration",
        "256 starts of LS-TRF, clustered, and what the data determine",
    ),
    Item(
        "table4",
        "Table 4 and Fig. 9: calibration by surrogate and polish",
        "the best of Fig. 6, trained again: screening and polish, small sizes with several seeds",
        needs=("fig6",),
        aliases=("fig9", "seeds"),
    ),
    Item(
        "whitebox",
        "Sec. 4: the white-box office",
        "a second model of the office, calibrated against the same data",
        cases=("office", "office-recorded"),
    ),
)


class ItemModule(Protocol):
    """What the module behind an item offers."""

    def inputs(self, plan: "Plan") -> dict[str, Any]:
        """Return all that decides the result, beside case and measurement, as JSON values."""

    def estimate_s(self, plan: "Plan") -> float:
        """Estimate how long it takes from nothing. [s]."""

    def run(self, plan: "Plan") -> "ItemResult":
        """Do it."""


class DrawnModule(ItemModule, Protocol):
    """What the module of an item offers that can be drawn from the files of an earlier run."""

    def drawn_from(self, folder: "Path") -> "tuple[Origin, ItemResult]":
        """Return where the files come from, and the result."""


DRAWN = ("fig6", "fig7", "table4")
"""Items that can be drawn from the files of an earlier run."""


def drawn_module(item: Item) -> DrawnModule:
    """Return the module that draws an item from files; the item is one of `DRAWN`."""
    return cast("DrawnModule", item_module(item))


def item_module(item: Item) -> ItemModule:
    """Return the module that does an item."""
    return cast("ItemModule", importlib.import_module(f"studies.paper.{item.name}"))


def chosen_items(words: list[str] | None) -> tuple[Item, ...]:
    """Return the items that some words mean, in the order of the paper; all of them without words.

    Raises:
        InputError: a word means no item.
    """
    if not words:
        return ITEMS
    meaning = {word: item for item in ITEMS for word in (item.name, *item.aliases)}
    unknown = [word for word in words if word not in meaning]
    if unknown:
        known = ", ".join(item.words for item in ITEMS)
        raise InputError(f"--only {unknown[0]}: there is no such item; there are {known}")
    wanted = {meaning[word].name for word in words}
    return tuple(item for item in ITEMS if item.name in wanted)


def with_needs(items: tuple[Item, ...], there: frozenset[str] = frozenset()) -> tuple[Item, ...]:
    """Return items with all that must be finished before them, in the order of the paper.

    Args:
        items: the items.
        there: names of what need not be made for them.
    """
    wanted = {item.name for item in items}
    for item in reversed(ITEMS):
        if item.name in wanted:
            wanted |= set(item.needs) - there
    return tuple(item for item in ITEMS if item.name in wanted)
