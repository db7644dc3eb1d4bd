"""One live instance of an FMU of FMI 2.0 or 3.0: its library, its functions, what it logs, its end."""

import contextlib
import ctypes
import os
import threading
from pathlib import Path
from typing import Any, Final

import fmpy
import numpy as np

from simulation.errors import InputError
from simulation.fmi.declared import binary_member
from simulation.fmi.description import FmuDescription
from simulation.fmi.log import CALLBACKS_2, LOGGER_3, forget_messages, last_message
from simulation.fmi.runner import NeedsFreshProcess
from simulation.fmi.variable import Interface
from simulation.foreign_code import foreign_code

OK: Final = 0
WARNING: Final = 1
DISCARD: Final = 2
FATAL: Final = 4
_STATUS: Final = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

_Pointer, _Int, _Bool, _Real, _Size = (
    ctypes.c_void_p,
    ctypes.c_int,
    ctypes.c_bool,
    ctypes.c_double,
    ctypes.c_size_t,
)
# Arguments after the instance, of functions that are the same for both versions, and of those that are not.
_ARGUMENTS: Final[dict[str, tuple[Any, ...]]] = {
    "GetFMUstate": (_Pointer,),
    "SetFMUstate": (_Pointer,),
    "FreeFMUstate": (_Pointer,),
}
_ARGUMENTS_2: Final[dict[str, tuple[Any, ...]]] = {
    "SetupExperiment": (_Int, _Real, _Real, _Int, _Real),
    "GetBooleanStatus": (_Int, _Pointer),
    **{
        f"{verb}{kind}": (_Pointer, _Size, _Pointer)
        for verb in ("Set", "Get")
        for kind in ("Real", "Integer", "Boolean", "String")
    },
}
_ARGUMENTS_3: Final[dict[str, tuple[Any, ...]]] = {
    "EnterInitializationMode": (_Bool, _Real, _Real, _Bool, _Real),
    **{
        f"{verb}{kind}": (_Pointer, _Size, _Pointer, _Size)
        for verb in ("Set", "Get")
        for kind in (
            *("Float64", "Float32", "Boolean", "String"),
            *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)),
        )
    },
}
# Loading changes the working directory of the whole process.
_LOADING: Final = threading.Lock()


class FmuInstance:
    """The loaded library of an FMU and its one instance, which may be replaced by a new one.

    Functions are named as in the standard without the version: "DoStep" is fmi2DoStep or fmi3DoStep. A status
    above WARNING makes the instance damaged: it is to be replaced before it is used again.

    Attributes:
        prefix: "fmi2" or "fmi3".
        component: Address of the instance.
        damaged: Whether the instance is to be replaced before it is used again.
        lost: Whether the FMU said that no instance of the process can be used again.
        keeps_state: Whether a state was saved that the instance may be brought back to.
    """

    def __init__(self, description: FmuDescription, interface: Interface, folder: Path) -> None:
        """Load the library and make the first instance.

        Args:
            description: What the FMU says of itself.
            interface: How it is to be driven.
            folder: Where it is unpacked.

        Raises:
            InputError: If the library cannot be loaded or refuses to be instantiated.
        """
        self._description = description
        self._interface: Interface = interface
        self._folder = folder
        self.prefix: Final = "fmi2" if description.fmi_version == "2.0" else "fmi3"
        self._arguments: Final = _ARGUMENTS | (_ARGUMENTS_2 if self.prefix == "fmi2" else _ARGUMENTS_3)
        self._functions: dict[str, Any] = {}
        self._library = self._load()
        self.component = 0
        self.damaged = False
        self.lost = False
        self.keeps_state = False
        self._initialized = False
        self._instantiate()
        if not self.component:
            said = f" ({message})" if (message := last_message()) else ""
            self._unload()
            raise InputError(
                f"{description.path}: the FMU refuses to be instantiated{said}; try it in another FMI tool"
            )

    def function(self, name: str) -> Any:
        """Find a function of the library.

        Args:
            name: Its name without the version.

        Returns:
            It, to be called from Python.

        Raises:
            InputError: If the library does not have it.
        """
        if name not in self._functions:
            full = self.full_name(name)
            try:
                found = getattr(self._library, full)
            except AttributeError:
                raise InputError(
                    f"{self._description.path}: its binary has no function {full}; export it again"
                ) from None
            found.restype = _Int
            found.argtypes = (_Pointer, *self._arguments.get(name, ()))
            self._functions[name] = found
        return self._functions[name]

    def has(self, name: str) -> bool:
        """Tell whether the library has a function.

        Args:
            name: Its name without the version.
        """
        return hasattr(self._library, self.full_name(name))

    def full_name(self, name: str) -> str:
        """Return the name of a function as the library has it: "DoStep" gives "fmi2DoStep"."""
        if self.prefix == "fmi3" and name.endswith("FMUstate"):
            name = name.replace("FMUstate", "FMUState")
        return self.prefix + name

    def addresses(self, *names: str) -> Any:
        """Return the addresses of functions.

        Args:
            names: Names without the version.

        Returns:
            Shape (n,), intp.
        """
        return np.array([ctypes.cast(self.function(name), _Pointer).value for name in names], dtype=np.intp)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function on the instance.

        Args:
            name: Its name without the version.
            arguments: What follows the instance.

        Returns:
            Its status; above WARNING the call failed.
        """
        status = int(self.function(name)(self.component, *arguments))
        self.lost = self.lost or status == FATAL
        return status

    def failure(self, name: str, status: int, time: float) -> str:
        """Say why a call failed, and mark the instance as damaged.

        Args:
            name: Function that was called, without the version.
            status: What it returned.
            time: Simulated time of the call. [s]

        Returns:
            One line.
        """
        self.damaged = True
        self.lost = self.lost or status == FATAL or status >= len(_STATUS)
        known = f"{self.prefix}{_STATUS[status]}" if 0 <= status < len(_STATUS) else f"status {status}"
        said = f": {message}" if (message := last_message()) else ""
        return f"{self.full_name(name)} returned {known} at {time:g} s{said}"

    def initialized(self) -> None:
        """Note that the initialization is over: before it is freed, the instance is to be terminated."""
        self._initialized = True

    def reset(self) -> bool:
        """Ask the FMU to be as if just instantiated.

        Returns:
            Whether it says that it is.
        """
        self._initialized = False
        return self.has("Reset") and self.call("Reset") <= WARNING

    def replace(self) -> None:
        """Free the instance and make a new one.

        Raises:
            NeedsFreshProcess: If the FMU said that all is lost, or makes no second instance in this process.
        """
        self._free_instance()
        if self.lost:
            raise NeedsFreshProcess(
                f"{self._description.path}: after {self.prefix}Fatal no instance of this process can be used"
            )
        self._instantiate()
        if not self.component:
            said = f" ({message})" if (message := last_message()) else ""
            raise NeedsFreshProcess(
                f"{self._description.path}: the FMU makes no second instance in one process{said}"
            )

    def close(self) -> None:
        """Free the instance and unload the library; closing twice does no harm."""
        if self._library is None:
            return
        self._free_instance()
        self._unload()

    def _load(self) -> Any:
        identifier = self._description.interface(self._interface, str(self._description.path))
        path = self._folder / binary_member(self._description.fmi_version, identifier.model_identifier)
        # Some libraries look for others beside them in the working directory.
        try:
            with _LOADING, contextlib.chdir(path.parent), foreign_code():
                return ctypes.CDLL(str(path))
        except OSError as error:
            said = " ".join(str(error).split())
            raise InputError(f"{self._description.path}: cannot be loaded ({said})") from None

    def _instantiate(self) -> None:
        forget_messages()
        self.damaged = self._initialized = False
        description, resources = self._description, self._folder / "resources"
        name = description.interface(self._interface, "").model_identifier.encode()
        guid = description.guid.encode()
        co_simulation = self._interface == "co-simulation"
        if self.prefix == "fmi2":
            make = self._maker("Instantiate")
            arguments: tuple[Any, ...] = (
                name,
                _Int(1 if co_simulation else 0),
                guid,
                resources.as_uri().encode(),
                ctypes.byref(CALLBACKS_2),
                _Int(0),
                _Int(0),
            )
        else:
            make = self._maker("InstantiateCoSimulation" if co_simulation else "InstantiateModelExchange")
            # The standard wants the folder to end with a separator.
            arguments = (name, guid, os.fsencode(resources) + os.sep.encode(), _Bool(False), _Bool(False))
            if co_simulation:
                # No event mode, no early return, no intermediate variables.
                arguments += (_Bool(False), _Bool(False), None, _Size(0))
            arguments += (None, LOGGER_3)
            if co_simulation:
                arguments += (None,)
        # Files that it writes while it starts go with the unpacked FMU.
        with _LOADING, contextlib.chdir(self._folder), foreign_code():
            self.component = int(make(*arguments) or 0)

    def _maker(self, name: str) -> Any:
        # As for any other function, a missing one is an InputError.
        self.function(name)
        make = self._library[self.full_name(name)]
        make.restype = _Pointer
        return make

    def _free_instance(self) -> None:
        # After a fatal error the standard allows no call at all, not even to free the instance.
        ends = self.component and self._initialized and not (self.damaged or self.lost)
        if ends and self.has("Terminate"):
            self.call("Terminate")
        if self.component and not self.lost:
            free = self._library[self.full_name("FreeInstance")]
            free.restype = None
            free.argtypes = (_Pointer,)
            free(self.component)
        self.component = 0

    def _unload(self) -> None:
        handle, self._library = self._library._handle, None
        self._functions = {}
        if not self.lost:
            with contextlib.suppress(Exception):
                fmpy.freeLibrary(handle)
