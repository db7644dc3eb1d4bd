"""A database that another program locks, or that is restarted, is waited for."""

import logging
import re
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import partial
from types import MethodType
from typing import Any, TypeVar

from simulation.errors import MachineError

T = TypeVar("T")
WAIT_S = 120.0
"""How long a database may be away; a backup locks it, and a server restarts, in less."""
_PAUSE_S = 1.0
_IS_AWAY = re.compile("refused|timeout|timed out|starting up|shutting down|terminat|closed the connection")
_IS_WITHIN = ContextVar("is_within", default=False)
_LOG = logging.getLogger(__name__)
_REMEDIES = {
    "database or disk is full": "free some space",
    "attempt to write a readonly database": "allow reading and writing there",
    "disk I/O error": "see to the disk, and to limits of files (ulimit -f)",
}
"""What SQLite says where waiting does not help, and the remedy."""


class Patient:
    """Mixed into a client of a database: its methods wait while the database is away.

    What a method had begun is asked again as a whole. Errors of other kinds pass.
    """

    def __getattribute__(self, name: str) -> Any:
        """Return an attribute; a method that waits."""
        found = super().__getattribute__(name)
        is_method = isinstance(found, MethodType) and not name.startswith("__")
        return partial(waited_for, found) if is_method else found


def waited_for(call: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Call a function of a database; while that is away, wait and call it again.

    Raises:
        MachineError: the database is away for longer than `WAIT_S`, or its disk is in the way.
    """
    if _IS_WITHIN.get():  # what a method calls within its transaction fails with it
        return call(*args, **kwargs)
    began = time.monotonic()
    is_said = False
    while True:
        token = _IS_WITHIN.set(True)
        try:
            return call(*args, **kwargs)
        except Exception as error:
            for said, remedy in _REMEDIES.items():
                if any(said in str(one) for one in _chain(error)):
                    raise MachineError(f"{said}; {remedy}, then type the command again") from None
            why = _why_away(error)
            if not why:
                # Optuna's own words of what its database said say nothing; notes come last.
                for cause in _chain(error.__cause__):
                    error.add_note(f"{type(cause).__name__}: {next(iter(str(cause).splitlines()), '')}")
                raise
            if time.monotonic() - began >= WAIT_S:
                raise MachineError(
                    f"{why} for {WAIT_S:.0f} s; see to it, then type the command again: nothing is lost"
                ) from None
        finally:
            _IS_WITHIN.reset(token)
        if not is_said:
            _LOG.warning(f"{why}; waiting for it, {WAIT_S:.0f} s at most")
            is_said = True
        time.sleep(_PAUSE_S)


def _why_away(error: BaseException) -> str:
    """Say why a database cannot be used at the moment; "" for errors that waiting does not mend."""
    for one in _chain(error):
        said = str(one)
        if "database is locked" in said:
            return "another program locks the SQLite database"
        # As SQLAlchemy knows it, and what it says of a session or a pool whose connections were lost.
        is_of_session = (
            type(one).__name__ in ("PendingRollbackError", "TimeoutError") and "sqlalche.me" in said
        )
        if is_of_session or getattr(one, "connection_invalidated", False):
            return "the PostgreSQL server cannot be reached"
        # SQLAlchemy's names are psycopg's.
        if {"OperationalError", "InterfaceError"} & {kind.__name__ for kind in type(one).__mro__}:
            if "psycopg" in said:
                return "the PostgreSQL server cannot be reached"
            # psycopg itself calls a wrong password or name of a database by the same name.
            if type(one).__module__.startswith("psycopg") and _IS_AWAY.search(said):
                return f"the PostgreSQL server cannot be reached ({said.splitlines()[0]})"
    return ""


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__
