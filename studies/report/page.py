"""The page: one HTML file that opens anywhere, with its pictures and the library that draws them."""

import base64
import gzip
import json
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

from simulation.whole_file import whole_file
from studies.report.contents import sections_of
from studies.report.data import ReportData, best_of
from studies.report.sentences import headline


def write_page(data: ReportData, file: Path) -> None:
    """Write a report as one page, in one step.

    Args:
        data: What to show.
        file: Where to; its folder is made.
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
    best = best_of(data.calibrations)
    lead = "Nothing has been calibrated yet." if best is None else f"{headline(data.case, best)}."
    text = environment.get_template("page.html").render(
        data=data, lead=lead, sections=sections_of(data), program=Markup(program), digest=digest
    )
    with whole_file(file) as stream:
        stream.write(text.encode())


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
