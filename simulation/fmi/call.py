"""Calls of C functions by their address, compiled by numba without the interpreter.

Addresses arrive as integers, so the machine code depends on no FMU and lies in numba's cache on disk: beside
the module, or in the user's cache folder where the package is read-only.
"""

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from llvmlite import ir
from numba import njit, typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

_Function = TypeVar("_Function", bound=Callable[..., Any])

# numba's cache looks at the file of a function only, not at those of the functions compiled into it; a name
# that carries the digest of all of them is never found with an old body.
SOURCES = ("call", "loop", "exchange_calls", "exchange_loop")
_DIGEST = hashlib.sha256(
    b"".join(Path(__file__).with_name(f"{name}.py").read_bytes() for name in SOURCES)
).hexdigest()[:12]


def compiled(function: _Function) -> _Function:
    """Compile a function without the interpreter's lock, from the cache on disk where there can be one.

    Args:
        function: The function, of a module in SOURCES, or of one whose functions call none of another module.

    Returns:
        The compiled function.
    """
    # error_model "numpy": a division by zero gives infinity as in C, instead of an exception.
    return cast(_Function, cached(function, partial(njit, nogil=True, error_model="numpy")))


def cached(function: Callable[..., Any], compiler: Callable[..., Any]) -> Any:
    """Compile a function, from the cache on disk where there can be one.

    Args:
        function: The function, of a module in SOURCES.
        compiler: numba's decorator with all of its options but `cache`.

    Returns:
        What the compiler made of it.
    """
    # The name is part of what numba's cache is searched by.
    function.__qualname__ = f"{function.__qualname__}_{_DIGEST}"
    try:
        return compiler(cache=True)(function)
    except RuntimeError:
        # numba found no folder to cache in (read-only package, no writable home): compile in every process.
        return compiler()(function)


def make_ready(function: Any, *arguments: Any) -> None:
    """Compile a function, or fetch it from the cache, for arguments of these types; do not call it.

    Args:
        function: A compiled() function.
        arguments: What it will be called with.
    """
    function.compile(tuple(typeof(argument) for argument in arguments))


def _call_status(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call a C function that returns a status; each item of the tuple has exactly its C type's width.

    A C bool is passed as an int32 of 0 or 1: either fills one register, with zeros above.
    """
    signature = types.int32(types.intp, arguments)

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        target, packed = values
        argument_types = [context.get_value_type(kind) for kind in arguments]
        function_type = ir.FunctionType(ir.IntType(32), argument_types)
        # From an argument: an address compiled into the code would hold for one process alone.
        function = builder.inttoptr(target, function_type.as_pointer())
        return builder.call(function, cgutils.unpack_tuple(builder, packed, len(argument_types)))

    return signature, generate


call_status: Any = intrinsic(_call_status)
