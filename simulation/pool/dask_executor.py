"""A Dask cluster as an executor: machines that share no files with this one; the only module with Dask."""

import hashlib
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.pool.processes import FILES
from simulation.whole_file import whole_file

try:
    from distributed import Client, WorkerPlugin
    from distributed.cfexecutor import ClientExecutor
    from distributed.scheduler import KilledWorker
except ImportError:
    raise InputError("--dask: Dask is not installed; pip install 'pelsvae-studies[dask]'") from None

_CONNECT_S = 15.0  # half of Dask's own default: a wrong address is found out soon


class DaskExecutor(ClientExecutor):
    """The workers behind a Dask scheduler; Dask itself gives a chunk whose worker dies to another."""

    lost = (KilledWorker,)
    """What futures raise when several workers died one after the other with the same chunk."""

    def __init__(self, address: str) -> None:
        """Connect to a scheduler.

        Args:
            address: The scheduler's, for instance tcp://scheduler:8786.

        Raises:
            InputError: If no scheduler answers there.
        """
        try:
            client = Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            said = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"{address}: no Dask scheduler answers there ({said}); start one") from None
        super().__init__(client, pure=False)

    @property
    def n_slots(self) -> int:
        """Chunks that the cluster works on at a time: the threads of its workers."""
        return sum(self._client.nthreads().values())

    def send_file(self, file: Path) -> str:
        """Bring a file to every worker, also to those that join later.

        Args:
            file: The file.

        Returns:
            Its key in FILES over there.
        """
        content = file.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        self._client.register_plugin(_FileOnWorker(digest, file.name, content), name=f"model-{digest}")
        return digest

    def shutdown(self, *arguments: Any, **options: Any) -> None:
        """Disconnect; the cluster goes on."""
        super().shutdown(*arguments, **options)
        self._client.close()


class _FileOnWorker(WorkerPlugin):
    """A file that every worker has in its own folder, under the digest of its content."""

    # The same file from two programs is written once.
    idempotent = True

    def __init__(self, digest: str, name: str, content: bytes) -> None:
        self._digest = digest
        self._name = name
        self._content = content

    def setup(self, worker: Any) -> None:
        file = Path(worker.local_directory) / "models" / self._digest / self._name
        with whole_file(file) as opened:
            opened.write(self._content)
        FILES[self._digest] = file
