"""The page itself: one HTML file that opens anywhere, with its pictures inside and everything escaped."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from studies.report.data import Provenance
from studies.report.tables import Table

FOOTER = (
    "Pictures (PNG), tables (CSV) and report.json lie beside this page; the page itself needs none of them."
)


class Head(Protocol):
    """What stands around the sections of a page."""

    @property
    def label(self) -> str:
        """Which results they are."""

    @property
    def title(self) -> str:
        """What the page is about."""

    @property
    def note(self) -> str:
        """What a reader must know first; may be empty."""

    @property
    def provenance(self) -> Provenance:
        """How to get the page again."""


@dataclass(frozen=True)
class Card:
    """A headline number: the value, and what it is."""

    value: str
    meaning: str


@dataclass(frozen=True)
class Picture:
    """A picture: name, heading, caption, and how it is drawn; None where its PNG is there."""

    name: str
    heading: str
    caption: str
    draw: Callable[[Path], Path] | None = None

    @property
    def file(self) -> str:
        """Name of the PNG."""
        return f"{self.name}.png"


@dataclass(frozen=True)
class Verdict:
    """What a comparison came to: one word, and the paragraph that says why."""

    word: str
    text: str


@dataclass(frozen=True)
class Section:
    """A part of the page; the reader opens folded ones, a leading one stands above the headline numbers."""

    anchor: str
    heading: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    folded: tuple[Section, ...] = ()
    verdict: Verdict | None = None
    paragraphs: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    is_leading: bool = False
    folder: Path | None = None

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to show."""
        return not (self.pictures or self.tables or self.folded or self.verdict or self.paragraphs)


def page(
    head: Head, lead: str, cards: Sequence[Card], sections: Sequence[Section], *, footer: str = FOOTER
) -> str:
    """Write the page.

    Args:
        head: Label, title, note and provenance.
        lead: The result in one sentence.
        cards: The headline numbers.
        sections: What follows, each with the folder that its pictures lie in; an empty one is left out.
        footer: What else there is.

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
    return template.render(head=head, lead=lead, cards=cards, sections=shown, footer=footer)
