"""The page: one HTML file that opens anywhere, with its pictures and the library that draws them."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from typing import Any

from studies.report.data import ReportData
from studies.report.drawing import Figure
from studies.report.tables import Table


@dataclass(frozen=True)
class KeyNumber:
    """A headline number: the value, and what it is."""

    value: str
    meaning: str


@dataclass(frozen=True)
class Picture:
    """A picture: name, caption, and what it shows."""

    name: str
    caption: str
    figure: Figure

    @property
    def file(self) -> str:
        """Name of the CSV file of its values."""
        return f"figure-{self.name}.csv"


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


def page(data: ReportData, lead: str, numbers: Sequence[KeyNumber], sections: Sequence[Section]) -> str:
    """Write the page.

    Args:
        data: Label, title, note and provenance.
        lead: The result in one sentence.
        numbers: The headline numbers.
        sections: What follows; an empty one is left out.

    Returns:
        A complete HTML document.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("studies.report", ""), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["packed"] = _packed
    program = _library() + files("studies.report").joinpath("charts.js").read_text(encoding="utf-8")
    digest = base64.b64encode(sha256(program.encode()).digest()).decode("ascii")
    shown = [section for section in sections if not section.is_empty]
    template = environment.get_template("page.html")
    return template.render(
        head=data, lead=lead, numbers=numbers, sections=shown, program=Markup(program), digest=digest
    )


def _packed(specification: Mapping[str, Any]) -> str:
    """Return JSON compressed, in base64: a sixth of the text, which counts where recordings are long."""
    content = json.dumps(specification, allow_nan=False).encode()
    return base64.b64encode(gzip.compress(content, mtime=0)).decode("ascii")


@cache
def _library() -> str:
    """Return the programs that draw, about 0.9 MB; putting them together takes two seconds."""
    from vl_convert import javascript_bundle

    # The stub demands an argument that the function does not need.
    library: str = javascript_bundle()  # type: ignore[call-arg]
    return library
