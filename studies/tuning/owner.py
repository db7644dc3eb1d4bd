"""Which process works on a trial, and whether it still lives."""

import socket
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import psutil

_SAME_START_S = 1.0  # the start of a process is derived from a clock that may be set meanwhile


def this_process() -> dict[str, Any]:
    """Describe the running process."""
    process = psutil.Process()
    return {"machine": this_machine(), "pid": process.pid, "started_s": process.create_time()}


@cache
def this_machine() -> str:
    """Name the set of processes that this one can see: a boot of a machine, or a container on it."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{socket.gethostname()}/{boot[:8]}/{Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return socket.gethostname()


def is_dead(owner: Mapping[str, Any]) -> bool:
    """Say whether a process of this machine has ended; of other machines Optuna's heartbeat tells."""
    if owner.get("machine") != this_machine():
        return False
    try:
        process = psutil.Process(int(owner["pid"]))
        is_same = abs(process.create_time() - float(owner["started_s"])) < _SAME_START_S
        return not is_same or bool(process.status() == psutil.STATUS_ZOMBIE)
    except (psutil.Error, KeyError, ValueError, TypeError):
        return True
