"""What all functions share: they check their keywords, open a task, and begin anew where that is needed."""

import inspect
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, TypeVar

from simulation.errors import ReuseError
from studies.keywords import check, typed
from studies.opening import open_task
from studies.tracking.sending import runs_sent
from studies.words.console import Console
from studies.words.quiet_loggers import working

if TYPE_CHECKING:
    from studies.task import Task


class HasPath(Protocol):
    """A case that was read, or a `Problem` of objects: it knows its case file."""

    @property
    def path(self) -> Path:
        """The case file."""


P = ParamSpec("P")
T = TypeVar("T")
DEFAULTS: dict[str, dict[str, Any]] = {}


def verb(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that refuses wrong keywords in one line and begins anew where its model needs it.

    Args:
        function: Does what the command of its name does.

    Returns:
        The function, which raises InputError for a wrong value and TypeError for an unknown keyword.
    """
    signature = inspect.signature(function)
    name = function.__name__
    DEFAULTS[name] = {key: one.default for key, one in signature.parameters.items()}

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        for unknown in kwargs.keys() - signature.parameters.keys():
            close = get_close_matches(unknown, signature.parameters, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise TypeError(f"{name}() got an unexpected keyword argument {unknown!r}{hint}")
        given = signature.bind(*args, **kwargs).arguments
        check(name, given)
        return begun_anew(partial(function, *args, **kwargs), given.get("console"))

    return checked


def begun_anew(work: Callable[[], T], console: Console | None) -> T:
    """Do work; once more where simulations that it began with were wrong and are removed.

    Args:
        work: What is done.
        console: Shows a warning before it begins anew.
    """
    with working(), runs_sent(shown(console).warn):
        try:
            return work()
        except ReuseError as error:
            shown(console).warn(f"{error}; the command begins anew")
            return work()


def shown(console: Console | None) -> Console:
    """Return what shows progress and results: by default all on standard error, as a notebook has it."""
    return Console(as_json=True) if console is None else console


def opened(name: str, given: Mapping[str, Any]) -> "Task":
    """Open the task that keywords name.

    Args:
        name: The function.
        given: All its keywords with their values.

    Raises:
        InputError: A keyword is wrong, or the label holds results of another case file.
    """
    case = given["case"]
    words = {**given, "case": getattr(case, "path", case)}
    return open_task(name, words, shown(given.get("console")), typed(name, words, DEFAULTS[name]))
