"""What an executor promises whose processes do not see this machine's files."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any


class RemoteExecutor(Executor, ABC):
    """An executor on other machines."""

    @property
    @abstractmethod
    def n_slots(self) -> int:
        """Pieces that it works on at a time."""

    @property
    @abstractmethod
    def lost(self) -> tuple[type[BaseException], ...]:
        """What its futures raise when processes were lost with their piece."""

    @abstractmethod
    def send_file(self, digest: str, name: str, content: bytes) -> None:
        """Bring a file to all its processes, also to those that come later.

        Args:
            digest: SHA-256 of the content, in hexadecimal; what is there already is not sent again.
            name: The file's name.
            content: What is in it.
        """

    @abstractmethod
    def submit_with_files(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function over there with one argument more, the first: the folder of the files."""
