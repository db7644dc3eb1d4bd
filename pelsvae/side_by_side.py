"""Independent computations on several threads; each answers as it would alone.

torch and SciPy release the interpreter's lock while they compute, so threads gain where matrices are large.
Every computation keeps to one thread: what it answers does not depend on how many there are.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from pelsvae.device import n_threads_set

T = TypeVar("T")
R = TypeVar("R")


class GivenUpError(Exception):
    """No one waits for this computation any more."""


class SideBySide:
    """Where computations run; made by `side_by_side`."""

    def __init__(self, threads: ThreadPoolExecutor | None) -> None:
        """Take the threads; None computes here, when an answer is asked for."""
        self._threads = threads
        self._given_up = threading.Event()

    @property
    def are_several(self) -> bool:
        """Whether there is more than one thread."""
        return self._threads is not None

    def each(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Yield what a function answers, in the items' order."""
        return map(function, items) if self._threads is None else self._threads.map(function, items)

    def later(self, function: Callable[[], R]) -> Callable[[], R]:
        """Begin a computation, and return what waits for its answer."""
        return cache(function) if self._threads is None else self._threads.submit(function).result

    def check(self) -> None:
        """End a long computation that no one waits for any more; it calls this now and then.

        Raises:
            GivenUpError: It is so.
        """
        if self._given_up.is_set():
            raise GivenUpError

    def give_up(self) -> None:
        """Let every computation end at its next check, and begin none."""
        self._given_up.set()
        if self._threads is not None:
            self._threads.shutdown(wait=True, cancel_futures=True)


@contextmanager
def side_by_side(n_jobs: int) -> Iterator[SideBySide]:
    """Compute on so many threads inside the block, each with one thread of torch.

    What ends the block early, as Ctrl-C does, ends the computations at their next check.

    Args:
        n_jobs: Threads; 1 computes in the caller's.
    """
    with n_threads_set(1):
        threads = SideBySide(ThreadPoolExecutor(n_jobs) if n_jobs > 1 else None)
        try:
            yield threads
        finally:
            threads.give_up()
