"""The one URL of a PostgreSQL server: read, checked, pointed at a schema, and shown without its password."""

import re
from urllib.parse import quote, unquote, urlsplit

from simulation.errors import InputError

STORAGE_VARIABLE = "STUDIES_STORAGE"
EXAMPLE = "postgresql://user@host/database"

_SCHEMES = ("postgresql", "postgres", "postgresql+psycopg")
_PASSWORD = re.compile(r"(\w://[^\s:/@]*):\S*@(?=[^\s@]*)")
_PASSWORD_OPTION = re.compile(r"([?&]password=)[^&\s]*")


def read_storage(given: str) -> str:
    """Return a storage URL in the form that libpq reads.

    Args:
        given: what the user wrote.

    Raises:
        InputError: it is no PostgreSQL URL, or it names no database.
    """
    shown = hide_passwords(given)
    try:
        parts = urlsplit(given)
        _ = parts.port
    except ValueError:  # what it says may quote the password
        parts = None
    if parts is None or "@" in parts.path:
        raise InputError(f"the storage {shown!r} is no URL; write {EXAMPLE}, and / in a password as %2F")
    if parts.scheme not in _SCHEMES:
        raise InputError(f"the storage {shown!r} is no PostgreSQL URL; write {EXAMPLE}")
    if not unquote(parts.path.strip("/")):
        raise InputError(f"the storage {shown!r} names no database; write {EXAMPLE}")
    return _joined("postgresql", parts.netloc, parts.path, parts.query)


def in_schema(storage: str, schema: str) -> str:
    """Return the URL by which SQLAlchemy finds one schema of the database.

    Args:
        storage: a URL as `read_storage` returns it.
        schema: the schema's name.
    """
    parts = urlsplit(storage)
    options = [part for part in parts.query.split("&") if part]
    ours = quote(f"-csearch_path={schema}", safe="")
    theirs = [part for part in options if part.startswith("options=")]
    joined = f"{theirs[-1]}%20{ours}" if theirs else f"options={ours}"
    query = "&".join([*(part for part in options if part not in theirs), joined])
    return _joined("postgresql+psycopg", parts.netloc, parts.path, query)


def hide_passwords(text: str) -> str:
    """Return a text with stars in the place of the passwords in its URLs."""
    return _PASSWORD_OPTION.sub(r"\1***", _PASSWORD.sub(r"\1:***@", text))


def _joined(scheme: str, netloc: str, path: str, query: str) -> str:
    # urlunsplit leaves out the slashes of a URL without a host, which libpq needs.
    return f"{scheme}://{netloc}{path}" + (f"?{query}" if query else "")
