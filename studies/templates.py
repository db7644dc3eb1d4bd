"""What fills the templates that lie beside modules: a missing name is an error."""

from jinja2 import Environment, PackageLoader, StrictUndefined


def environment(folder: str, *, escapes: bool = False) -> Environment:
    """Return what fills the templates of a folder.

    Args:
        folder: of this package, for example "reporting".
        escapes: whether values are escaped, as HTML needs it.
    """
    return Environment(
        loader=PackageLoader("studies", folder), autoescape=escapes, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
