"""What one worker had to import and compile, handed on to those that come after it."""

import contextlib
import importlib
import pickle
import sys
from collections.abc import Iterator
from typing import Any, Final

_ROOM: Final = "simulation"


def learnt() -> bytes:
    """Return the modules that this process has imported and the machine code that it has in memory.

    Returns:
        For remember() in another process; names and signatures, no code.
    """
    code = [(module, name, loop.signatures) for module, name, loop in _loops() if loop.signatures]
    return pickle.dumps((sorted(_modules()), code))


def remember(known: bytes) -> None:
    """Import and compile in this process, mostly from numba's cache on disk, what another had learnt.

    Args:
        known: From learnt().
    """
    modules, code = pickle.loads(known)
    for module in modules:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    loops = {(module, name): loop for module, name, loop in _loops()}
    for module, name, signatures in code:
        for signature in signatures:
            # At worst, every worker compiles it for itself.
            with contextlib.suppress(Exception):
                loops[module, name].compile(signature)


def _modules() -> list[str]:
    return [name for name in sys.modules if name.split(".", 1)[0] == _ROOM]


def _loops() -> Iterator[tuple[str, str, Any]]:
    """Find the functions that numba compiles when they are first called; without importing numba."""
    for module in _modules():
        for name, value in list(vars(sys.modules[module]).items()):
            if type(value).__module__.startswith("numba.") and hasattr(value, "signatures"):
                yield module, name, value
