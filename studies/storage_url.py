"""The one URL of a PostgreSQL server: read, checked, and pointed at a schema. It holds no password."""

import re
from urllib.parse import quote, unquote, urlsplit

from simulation.errors import InputError

STORAGE_VARIABLE = "STUDIES_STORAGE"
EXAMPLE = "postgresql://user@host/database"

_SCHEMES = ("postgresql", "postgres", "postgresql+psycopg")
_SECRET = re.compile(r"passw|passphrase|pwd|secret|token|api_?key", re.IGNORECASE)


def read_storage(given: str) -> str:
    """Return a storage URL in the form that libpq reads.

    Args:
        given: what the user wrote; messages do not show it, as a password may stand anywhere in it.

    Raises:
        InputError: it is no PostgreSQL URL, it names no database, or it holds a password.
    """
    try:
        parts = urlsplit(given)
        _ = parts.port
    except ValueError:
        parts = urlsplit("")
    is_odd = any(sign.isspace() or not sign.isprintable() for sign in given)
    if is_odd or parts.scheme not in _SCHEMES or parts.fragment or "@" in f"{parts.path}{parts.query}":
        raise InputError(f"the storage is no PostgreSQL URL; write {EXAMPLE}")
    if not unquote(parts.path.strip("/")):
        raise InputError(f"the storage names no database; write {EXAMPLE}")
    options = [unquote(option.rpartition("=")[0]) for option in parts.query.split("&")]
    if parts.password is not None or any(map(_SECRET.search, options)):
        raise InputError(
            "the storage holds a password, which other programs and records would show; write "
            f"{EXAMPLE}, and the password into ~/.pgpass or $PGPASSWORD"
        )
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


def _joined(scheme: str, netloc: str, path: str, query: str) -> str:
    # urlunsplit leaves out the slashes of a URL without a host, which libpq needs.
    return f"{scheme}://{netloc}{path}" + (f"?{query}" if query else "")
