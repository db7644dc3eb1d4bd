"""The texts of an FMU: the templates beside this module, filled with what a model is."""

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_ESCAPED = {'"': "&quot;", "\n": "&#10;", "\t": "&#09;"}


def filled(template: str, **values: Any) -> str:
    """Return the text of a template."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {"attributes": _attributes, "number": _number, "quoted": '"{}"'.format}
    return environment.get_template(template).render(**values)


def _attributes(pairs: dict[str, Any]) -> str:
    return "".join(f' {name}="{escape(str(value), _ESCAPED)}"' for name, value in pairs.items())


def _number(value: float) -> str:
    return repr(float(value)).replace("inf", "HUGE_VAL")
