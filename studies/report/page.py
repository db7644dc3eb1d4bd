"""The page itself: one HTML file that opens anywhere, with its pictures inside and everything escaped."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Protocol

from studies.report.data import Provenance
from studies.report.tables import Table

TEMPLATE = Path(__file__).with_name("page.html")
FOOTER = (
    "Pictures (PNG), tables (CSV, Markdown) and report.json lie beside this page; "
    "the page itself needs none of them."
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
class PlacedPicture:
    """A picture on the page: its PNG, what it is called, and what it says."""

    path: Path
    heading: str
    caption: str


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
    pictures: tuple[PlacedPicture, ...] = ()
    tables: tuple[Table, ...] = ()
    folded: tuple[Section, ...] = ()
    verdict: Verdict | None = None
    paragraphs: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    is_leading: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to show."""
        return not (self.pictures or self.tables or self.folded or self.verdict or self.paragraphs)


def page(
    data: Head, lead: str, cards: Sequence[Card], sections: Sequence[Section], *, footer: str = FOOTER
) -> str:
    """Write the page.

    Args:
        data: Label, title, note and provenance are taken from it.
        lead: The result in one sentence.
        cards: The headline numbers.
        sections: What follows; an empty one is left out.
        footer: What else there is.

    Returns:
        A complete HTML document.
    """
    shown = [section for section in sections if not section.is_empty]
    created = f" · {escape(data.provenance.created)}" if data.provenance.created else ""
    links = "".join(f'<a href="#{escape(s.anchor)}">{escape(s.heading)}</a>' for s in shown)
    note = f'<p class="note" role="note"><strong>Note.</strong> {escape(data.note)}</p>' if data.note else ""
    body = [
        f'<header><h1>{escape(data.title)}</h1><p class="sub">{escape(data.label)}{created}</p>',
        f'<nav aria-label="Contents">{links}<a href="#again">Do it again</a></nav></header>',
        f'<main>{note}<p class="lead">{escape(lead)}</p>',
        *(_section(section) for section in shown if section.is_leading),
        _cards(cards),
        *(_section(section) for section in shown if not section.is_leading),
        _again(data.provenance),
        "</main>",
        f"<footer>{escape(footer)}</footer>",
    ]
    template = Template(TEMPLATE.read_text(encoding="utf-8"))
    return template.substitute(title=escape(f"{data.label}: {data.title}"), body="\n".join(body))


def _cards(cards: Sequence[Card]) -> str:
    if not cards:
        return ""
    items = "".join(
        f'<div class="card"><b>{escape(card.value)}</b><span>{escape(card.meaning)}</span></div>'
        for card in cards
    )
    return f'<div class="cards">{items}</div>'


def _section(section: Section) -> str:
    heading = f"<h2>{escape(section.heading)}</h2>"
    return f'<section id="{escape(section.anchor)}">{heading}{_content(section)}</section>'


def _content(section: Section) -> str:
    parts = [f"<p>{escape(paragraph)}</p>" for paragraph in section.paragraphs]
    if section.verdict is not None:
        word, text = escape(section.verdict.word), escape(section.verdict.text)
        parts.append(f'<p class="verdict"><strong>{word}.</strong> {text}</p>')
    parts += [_picture(picture) for picture in section.pictures]
    parts += [table.to_html() for table in section.tables]
    parts += [
        f"<details><summary>{escape(part.heading)}</summary>{_content(part)}</details>"
        for part in section.folded
    ]
    parts.append(_pairs(section.facts))
    return "".join(parts)


def _pairs(pairs: Sequence[tuple[str, str]]) -> str:
    if not pairs:
        return ""
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in pairs)
    return f"<dl>{rows}</dl>"


def _picture(picture: PlacedPicture) -> str:
    content = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    alternative = escape(f"{picture.heading}. {picture.caption}")
    return (
        f"<figure><h3>{escape(picture.heading)}</h3>"
        f'<img alt="{alternative}" src="data:image/png;base64,{content}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def _again(provenance: Provenance) -> str:
    commands = "\n".join(provenance.commands)
    parts = ['<section id="again"><h2>Do it again</h2>']
    if commands:
        parts.append(f"<pre>{escape(commands)}</pre>")
    for heading, pairs in (
        ("Settings and seeds", provenance.settings),
        ("Digests", provenance.digests),
        ("Versions", provenance.versions),
    ):
        if pairs:
            parts.append(f"<h3>{heading}</h3>{_pairs(pairs)}")
    parts.append("</section>")
    return "".join(parts)
