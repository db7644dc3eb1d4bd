"""The one URL of a PostgreSQL server: read, checked, pointed at a schema; and texts without passwords."""

import re
from urllib.parse import quote, unquote, urlsplit

from simulation.errors import InputError

STORAGE_VARIABLE = "STUDIES_STORAGE"
EXAMPLE = "postgresql://user@host/database"

_SCHEMES = ("postgresql", "postgres", "postgresql+psycopg")
_OTHERS = ("mysql", "mariadb", "sqlite", "mongodb", "http", "https", "file")
_BAD_ESCAPE = re.compile(r"%(?![0-9A-Fa-f]{2})")
_HIDDEN = "***"
# From the colon behind a user to the last @ of the text, whatever is in between, but what is hidden.
_IN_URL = re.compile(r"(\w://[^\s:]*?)(?::|%3[Aa])(?!\*\*\*@[^\s@]*(?:\s|$)).*@", re.DOTALL)
# The same where no :// says that there is a URL, as far as there is no blank.
_IN_WORD = re.compile(r"((?<!\S)[^\s:]*):(?!//)\S*@")
# A URL that has a colon and no @ behind it: only a port is none.
_UNENDED = re.compile(r"(\w://(?:\[[^\]\s]*\]|[^\s:/?#\[]*)):(?!\d{1,5}(?:\D|$)|\*\*\*)(?!.*@).*", re.DOTALL)
_OPTION = re.compile(r"([\w%.-]+)[\"']?\s*(?:=|%3[Dd]|(?<=[\"'])\s*:)\s*")
_SECRET = re.compile(r"passw|passphrase|pwd|secret|token|api_?key", re.IGNORECASE)


def read_storage(given: str) -> str:
    """Return a storage URL in the form that libpq reads.

    Args:
        given: what the user wrote; messages show its scheme alone, as a password may stand anywhere in it.

    Raises:
        InputError: it is no PostgreSQL URL, it names no database, or its password would be seen by others.
    """
    scheme = given.partition("://")[0]
    what = f"the storage {scheme}://..." if scheme in (*_SCHEMES, *_OTHERS) else "the storage"
    try:
        parts = urlsplit(given)
        _ = parts.port
    except ValueError:
        parts = None
    if parts is None or any(_is_strange(sign) for sign in given) or _BAD_ESCAPE.search(given):
        raise InputError(
            f"{what} is no URL; write {EXAMPLE}, and / @ : ? # % blanks in a password as %2F ..."
        )
    options = [option.partition("=") for option in parts.query.split("&") if option]
    if parts.fragment or f"{parts.netloc}{parts.path}{parts.query}".count("@") > ("@" in parts.netloc):
        raise InputError(f"{what} is no URL; write {EXAMPLE}, and / in a password as %2F, @ as %40, # as %23")
    if not all(is_equal for _, is_equal, _ in options):
        raise InputError(f"{what} is no URL: an option behind the ? has no =; write {EXAMPLE}")
    if parts.scheme not in _SCHEMES:
        raise InputError(f"{what} is no PostgreSQL URL; write {EXAMPLE}")
    if not unquote(parts.path.strip("/")):
        raise InputError(f"{what} names no database; write {EXAMPLE}")
    if any(_SECRET.search(unquote(name)) for name, _, _ in options):
        raise InputError(
            f"{what} has a password among its options, which programs show; write it between the user "
            "and the host, or set $PGPASSWORD"
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


def hide_passwords(text: str) -> str:
    """Return a text with stars in the place of all that may be a password, and of more where it is not clear.

    Hidden are what stands between the user and the last @ behind a URL, and all that follows the name of an
    option like `password=` or `sslpassword=`, whose value may be quoted, escaped or neither. A URL whose
    password was hidden before stays as it is, so that the line around it can be shown.
    """
    for option in _OPTION.finditer(text):
        if _SECRET.search(unquote(option[1])):
            # It may stand in the password of a URL, which ends at an @.
            ending = "@" if "@" in text[option.end() :] else ""
            text = f"{text[: option.end()]}{_HIDDEN}{ending}"
            break
    for pattern, ending in ((_IN_URL, "@"), (_IN_WORD, "@"), (_UNENDED, "")):
        text = pattern.sub(rf"\1:{_HIDDEN}{ending}", text)
    return text


def _is_strange(sign: str) -> bool:
    return sign.isspace() or not sign.isprintable()


def _joined(scheme: str, netloc: str, path: str, query: str) -> str:
    # urlunsplit leaves out the slashes of a URL without a host, which libpq needs.
    return f"{scheme}://{netloc}{path}" + (f"?{query}" if query else "")
