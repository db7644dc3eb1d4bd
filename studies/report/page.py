"""The page itself: one HTML file that opens anywhere, with its pictures inside and everything escaped."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from studies.report.data import ReportData
from studies.report.tables import Table


@dataclass(frozen=True)
class Card:
    """A headline number: the value, and what it is."""

    value: str
    meaning: str


@dataclass(frozen=True)
class Picture:
    """A picture: name, heading, caption, and how it is drawn."""

    name: str
    heading: str
    caption: str
    draw: Callable[[Path], Path]

    @property
    def file(self) -> str:
        """Name of the PNG."""
        return f"{self.name}.png"


@dataclass(frozen=True)
class Section:
    """A part of the page; the reader opens folded ones, a leading one stands above the headline numbers."""

    anchor: str
    heading: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    folded: tuple[Section, ...] = ()
    paragraphs: tuple[str, ...] = ()
    is_leading: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to show."""
        return not (self.pictures or self.tables or self.folded or self.paragraphs)


def page(
    data: ReportData, lead: str, cards: Sequence[Card], sections: Sequence[Section], folder: Path
) -> str:
    """Write the page.

    Args:
        data: Label, title, note and provenance.
        lead: The result in one sentence.
        cards: The headline numbers.
        sections: What follows; an empty one is left out.
        folder: Where the pictures lie.

    Returns:
        A complete HTML document.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("studies.report", ""), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["encoded"] = lambda file: base64.b64encode(file.read_bytes()).decode("ascii")
    shown = [section for section in sections if not section.is_empty]
    template = environment.get_template("page.html")
    return template.render(head=data, lead=lead, cards=cards, sections=shown, folder=folder)
