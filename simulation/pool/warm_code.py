"""What one worker had to compile, handed on to those that come after it."""

import contextlib
import importlib
import pickle
import sys
from collections.abc import Iterator
from typing import Any

ROOM = "simulation"


def learnt() -> bytes:
    """Return what machine code this process has in memory.

    Returns:
        For remember() in another process; names and signatures, no code.
    """
    return pickle.dumps([(module, name, loop.signatures) for module, name, loop in _loops()])


def remember(known: bytes) -> None:
    """Compile in this process, mostly from numba's cache on disk, what another had learnt.

    Args:
        known: From learnt().
    """
    for module, name, signatures in pickle.loads(known):
        for signature in signatures:
            # At worst, every worker compiles it for itself.
            with contextlib.suppress(Exception):
                getattr(importlib.import_module(module), name).compile(signature)


def _loops() -> Iterator[tuple[str, str, Any]]:
    """Find the functions that numba compiles when they are first called; without importing numba."""
    for module in [name for name in sys.modules if name.partition(".")[0] == ROOM]:
        for name, value in list(vars(sys.modules[module]).items()):
            if type(value).__module__.startswith("numba.") and hasattr(value, "signatures"):
                yield module, name, value
