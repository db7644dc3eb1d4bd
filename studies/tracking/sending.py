"""Runs reach a server through a process of its own, one per project that a command works on."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict

from simulation.pool.family import end_with_parent
from studies.paths import ProjectPaths

_SENDERS: ContextVar[dict[ProjectPaths, "subprocess.Popen[str]"] | None] = ContextVar("senders", default=None)
# MLflow alone would try a server that is away for minutes; what is not sent now is sent later.
_PATIENCE = {
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
}
# To print the address of a run that ends, MLflow asks for the run once more.
_QUIET = {"MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true"}


@contextmanager
def runs_sent(warn: Callable[[str], None]) -> Iterator[None]:
    """Send what is written meanwhile to the server that a project has.

    Args:
        warn: called with each line that a user should see, at the end.
    """
    if _SENDERS.get() is not None:  # a part of a larger command
        yield
        return
    senders: dict[ProjectPaths, subprocess.Popen[str]] = {}
    token = _SENDERS.set(senders)
    try:
        yield
        for one in senders.values():
            said, _ = one.communicate()
            for line in said.splitlines():
                warn(line)
    finally:
        _SENDERS.reset(token)
        for one in senders.values():
            one.kill()
            one.wait()
            for stream in (one.stdin, one.stdout):
                if stream is not None:
                    stream.close()


def begin_sending(paths: ProjectPaths) -> None:
    """Have the runs of a project sent from now on, where it has a server and a command asked for that."""
    senders = _SENDERS.get()
    if senders is None or paths.server is None or paths in senders:
        return
    sender = subprocess.Popen(
        [sys.executable, "-P", "-m", "studies.tracking.sender"],
        cwd=paths.root,
        env=_PATIENCE | dict(os.environ) | _QUIET,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,  # Ctrl-C is for the command
        preexec_fn=end_with_parent,
    )
    senders[paths] = sender
    given = {"root": str(paths.root), "storage": paths.storage, "server": asdict(paths.server)}
    assert sender.stdin is not None, "a pipe"
    sender.stdin.write(json.dumps(given) + "\n")
    sender.stdin.flush()
