"""A Dask cluster as an executor: machines that share no files with this one; the only module with Dask."""

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Final

from distributed import Client, WorkerPlugin, get_worker
from distributed.scheduler import KilledWorker

from simulation.errors import InputError
from simulation.whole_file import whole_file
from simulation.workers.remote_executor import RemoteExecutor

# Dask is typed in parts.
_connect: Any = Client
_CONNECT_S: Final = 15.0
_FILES: Final = "models"


class DaskExecutor(RemoteExecutor):
    """The workers behind a Dask scheduler; Dask itself gives a piece whose worker dies to another."""

    def __init__(self, address: str) -> None:
        """Connect.

        Args:
            address: The scheduler's, for instance tcp://scheduler:8786.

        Raises:
            InputError: If no scheduler answers there.
        """
        try:
            self._client: Any = _connect(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            said = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"{address}: no Dask scheduler answers there ({said}); start one") from None
        self._executor: Any = self._client.get_executor(pure=False)
        self._sent: set[str] = set()

    @property
    def n_slots(self) -> int:
        """Pieces that the cluster works on at a time: the threads of its workers."""
        return sum(self._client.nthreads().values())

    @property
    def lost(self) -> tuple[type[BaseException], ...]:
        """What futures raise when several workers died one after the other with the same piece."""
        return (KilledWorker,)

    def send_file(self, digest: str, name: str, content: bytes) -> None:
        """Bring a file to every worker, also to those that join later.

        Args:
            digest: SHA-256 of the content, in hexadecimal; what is there already is not sent again.
            name: The file's name.
            content: What is in it.
        """
        if digest not in self._sent:
            self._client.register_plugin(_FileOnWorker(digest, name, content), name=f"model-{digest}")
            self._sent.add(digest)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> "Future[Any]":
        """Call a function on a worker."""
        future: Future[Any] = self._executor.submit(function, *arguments, **named)
        return future

    def submit_with_files(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function on a worker with one argument more, the first: the folder of its files."""
        return self.submit(_with_files, function, *arguments)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Disconnect; the cluster goes on."""
        self._executor.shutdown(wait=wait and not cancel_futures)
        self._client.close()


class _FileOnWorker(WorkerPlugin):  # type: ignore[misc, unused-ignore]
    """A file that every worker has in its scratch folder, under the digest of its content."""

    # The same file from two campaigns is written once.
    idempotent = True

    def __init__(self, digest: str, name: str, content: bytes) -> None:
        self._place = Path(_FILES) / digest / name
        self._content = content

    def setup(self, worker: Any) -> None:
        with whole_file(Path(worker.local_directory) / self._place) as file:
            file.write(self._content)


def _with_files(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(Path(get_worker().local_directory) / _FILES, *arguments)
