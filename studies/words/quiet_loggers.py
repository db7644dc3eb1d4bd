"""What other libraries log while this program works, which is not for the user of a script that calls it.

Levels of loggers are the script's. So records are filtered by who works, in each thread by itself.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_IS_WORKING = ContextVar("is_working", default=False)


@contextmanager
def working() -> Iterator[None]:
    """Leave out of the log what this program causes meanwhile, as `hush` says."""
    token = _IS_WORKING.set(True)
    try:
        yield
    finally:
        _IS_WORKING.reset(token)


class _Hushed(logging.Filter):
    def __init__(self, level: int) -> None:
        super().__init__()
        self._level = level

    def filter(self, record: logging.LogRecord) -> bool:
        return record.levelno >= self._level or not _IS_WORKING.get()


def hush(name: str, level: int) -> None:
    """Leave out what a logger, or the library of that name by its own handlers, logs below a level.

    Args:
        name: of the logger.
        level: the least that is still logged while this program works.
    """
    logger = logging.getLogger(name)
    for one in (logger, *logger.handlers):
        one.addFilter(_Hushed(level))
