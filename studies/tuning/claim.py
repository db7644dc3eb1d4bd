"""Who works on a trial: the claim on its place in the study, and whether its owner still lives."""

import socket
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import psutil

GRACE_S = 120.0  # an owner on another machine that is silent for so long is dead; outlasts a server's restart
BEAT_S = 2.0
_SAME_START_S = 1.0  # the start of a process is derived from a clock that may be set meanwhile


@dataclass(frozen=True)
class Claim:
    """A trial that somebody has begun.

    Args:
        index: its place in the study.
        params: hyperparameters in search coordinates; a repeated attempt takes the same ones.
        config: all settings of the surrogate.
        seed: seed of its training.
        origin: why these hyperparameters.
        started_s: start of this attempt. [s since 1970, UTC]
        max_epochs: most epochs it may take.
        owner: host, process and its start; empty where the trial was interrupted and waits.
        token: distinguishes this attempt from all others.
        attempt: 1 for the first.
        n_crashes: attempts that brought their process down.
        n_lost: attempts that ended with their whole command or machine.
        crash: how the last process ended.
    """

    index: int
    params: dict[str, float | int]
    config: dict[str, Any]
    seed: int
    origin: str
    started_s: float
    max_epochs: int
    owner: dict[str, Any] = field(default_factory=dict)
    token: str = ""
    attempt: int = 1
    n_crashes: int = 0
    n_lost: int = 0
    crash: str = ""

    @property
    def is_owned(self) -> bool:
        """Whether somebody works on it, or died while doing so."""
        return bool(self.owner)

    def taken(self, owner: dict[str, Any], started_s: float) -> "Claim":
        """Return the claim with an owner."""
        return replace(self, owner=owner, token=uuid.uuid4().hex, started_s=started_s)

    def released(self, *, crash: str = "", lost: bool = False) -> "Claim":
        """Return the claim without an owner, for whoever comes next.

        Args:
            crash: how its process ended, where that was the trial's own doing.
            lost: whether its owner vanished and nobody knows why.
        """
        return replace(
            self,
            owner={},
            token="",
            attempt=self.attempt + 1,
            n_crashes=self.n_crashes + bool(crash),
            n_lost=self.n_lost + lost,
            crash=crash or self.crash,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the claim as JSON values."""
        return asdict(self)


def this_owner(command_pid: int | None = None) -> dict[str, Any]:
    """Describe the running process, so that a reader can tell who works on a trial.

    Args:
        command_pid: process of the command that looks after this one.
    """
    owner = {"host": socket.gethostname(), "machine": this_machine(), **_process(psutil.Process())}
    owner["worker"] = uuid.uuid4().hex[:8]  # one process may have several
    if command_pid is not None:
        owner["command"] = _process(psutil.Process(command_pid))
    return owner


@cache
def this_machine() -> str:
    """Name the set of processes that this one can see: a boot of a machine, or a container on it.

    Two containers may have the same host name and the same process ids.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{socket.gethostname()}/{boot[:8]}/{Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return socket.gethostname()


def is_dead(owner: Mapping[str, Any], silence_s: float) -> bool:
    """Return whether the owner of a claim has died, and nobody of its own will see to it.

    Args:
        owner: as `this_owner` described it.
        silence_s: how long it has not been heard of. [s]
    """
    if owner.get("machine") != this_machine():
        return silence_s > GRACE_S
    if _is_running(owner):
        return False
    # Its command knows best why it died, and says so at once.
    return not _is_running(owner.get("command", {})) or silence_s > GRACE_S


def _process(process: psutil.Process) -> dict[str, Any]:
    return {"pid": process.pid, "process_started_s": process.create_time()}


def _is_running(described: Mapping[str, Any]) -> bool:
    try:
        process = psutil.Process(int(described["pid"]))
        is_same = abs(process.create_time() - float(described["process_started_s"])) < _SAME_START_S
        return is_same and process.status() != psutil.STATUS_ZOMBIE
    except (psutil.Error, KeyError):
        return False
