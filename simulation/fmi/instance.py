"""One live instance of an FMU of FMI 2.0 or 3.0: its library, its functions, what it logs, its end."""

import contextlib
import ctypes
import os
import threading
from collections.abc import Sequence
from ctypes import c_bool, c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from simulation.fmi.description import FmuDescription
from simulation.fmi.log import CALLBACKS_2, LOGGER_3, forget_messages
from simulation.fmi.status import FATAL, WARNING, Instance
from simulation.fmi.variable import Interface
from simulation.foreign_code import foreign_code

# Loading changes the working directory of the whole process.
_LOADING = threading.Lock()


class FmuInstance(Instance):
    """The library of an FMU, loaded into this process, and its one instance.

    Attributes:
        component: Address of the instance.
        is_initialized: Whether the initialization is over, and the instance is to be terminated at its end.
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
        super().__init__(description.path, description.fmi_version)
        found = description.interface(interface, str(description.path))
        self._identifier = found.model_identifier
        self._guid = description.guid.encode()
        self._is_co_simulation = interface == "co-simulation"
        self._folder = folder
        self._functions: dict[str, Any] = {}
        self._library = self._load(found.binary)
        self._instantiate()
        if not self.component:
            # Some FMUs say why only where logging is on.
            self._instantiate(is_logging=True)
        if not self.component:
            refusal = self.refusal()
            self._unload()
            raise refusal

    def has(self, name: str) -> bool:
        """Return whether the library has a function of this name."""
        return hasattr(self._library, self.full_name(name))

    def addresses(self, *names: str) -> Any:
        """Return the addresses of functions. Shape (n,), intp.

        Raises:
            InputError: If the library lacks one.
        """
        found = [ctypes.cast(self._function(name), c_void_p).value for name in names]
        return np.array(found, dtype=np.intp)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function on the instance.

        Args:
            name: Its name without the version.
            arguments: What follows the instance: float numbers, and integers and addresses, which are given
                64 bits each; of the same types at every call.

        Returns:
            Its status; above WARNING the call failed.

        Raises:
            InputError: If the library lacks it.
        """
        function = self._functions.get(name)
        if function is None:
            function = self._functions[name] = self._function(name)
            function.restype = c_int
            kinds = (c_double if isinstance(one, float) else c_void_p for one in arguments)
            function.argtypes = (c_void_p, *kinds)
        status = int(function(self.component, *arguments))
        self.lost = self.lost or status == FATAL
        return status

    def call_all(self, calls: Sequence[tuple[Any, ...]], time: float) -> str:
        """Call functions on the instance until one fails.

        Args:
            calls: Their names without the version, each with its arguments.
            time: Simulated time, for the message. [s]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        for call in calls:
            status = self.call(*call)
            if status > WARNING:
                return self.failure(call[0], status, time)
        return ""

    def reset(self) -> bool:
        """Ask the FMU to be as if just instantiated.

        Returns:
            Whether it says that it is.
        """
        self.is_initialized = False
        return self.has("Reset") and self.call("Reset") <= WARNING

    def replace(self) -> None:
        """Free the instance and make a new one.

        Raises:
            NeedsFreshProcess: If the FMU said that all is lost, or makes no second instance in this process.
        """
        # First: some FMUs allow one instance at a time.
        self._free_instance()
        if not self.lost:
            self._instantiate()
        if not self.component:
            raise self.no_other()

    def close(self) -> None:
        """Free the instance and unload the library; closing twice does no harm."""
        if self._library is not None:
            self._free_instance()
            self._unload()

    def _load(self, member: str) -> Any:
        path = self._folder / member
        # Some libraries look for others beside them in the working directory.
        try:
            with _LOADING, contextlib.chdir(path.parent), foreign_code():
                return ctypes.CDLL(str(path))
        except OSError as error:
            said = " ".join(str(error).split())
            raise self.not_loaded(said) from None

    def _function(self, name: str) -> Any:
        """Find a function anew, with no types yet."""
        full = self.full_name(name)
        try:
            return self._library[full]
        except AttributeError:
            raise self.no_function(full) from None

    def _instantiate(self, is_logging: bool = False) -> None:
        forget_messages()
        self.damaged = self.is_initialized = False
        name, resources = self._identifier.encode(), self._folder / "resources"
        no, logging = c_bool(False), c_bool(is_logging)
        if self.prefix == "fmi2":
            function = "Instantiate"
            kind, uri = c_int(1 if self._is_co_simulation else 0), resources.as_uri().encode()
            visible, logging_2 = c_int(0), c_int(is_logging)
            callbacks = ctypes.byref(CALLBACKS_2)
            arguments: tuple[Any, ...] = (name, kind, self._guid, uri, callbacks, visible, logging_2)
        else:
            # The standard wants the folder to end with a separator.
            arguments = (name, self._guid, os.fsencode(resources) + os.sep.encode(), no, logging)
            if self._is_co_simulation:
                function = "InstantiateCoSimulation"
                # No event mode, no early return, no intermediate variables.
                arguments += (no, no, None, c_size_t(0), None, LOGGER_3, None)
            else:
                function = "InstantiateModelExchange"
                arguments += (None, LOGGER_3)
        make = self._function(function)
        make.restype = c_void_p
        # Files that it writes while it starts go with the unpacked FMU.
        with _LOADING, contextlib.chdir(self._folder), foreign_code():
            self.component = int(make(*arguments) or 0)

    def _free_instance(self) -> None:
        # After a fatal error the standard allows no call at all, not even to free the instance.
        if self.component and not self.lost:
            # After an error the standard allows to free an instance, not to terminate it.
            if self.is_initialized and not self.damaged and self.has("Terminate"):
                self.call("Terminate")
            if not self.lost:
                free = self._function("FreeInstance")
                free.restype = None
                free(c_void_p(self.component))
        self.component = 0

    def _unload(self) -> None:
        handle, self._library = self._library._handle, None
        self._functions = {}
        # Unloading runs the library's own code once more.
        if not self.lost:
            with contextlib.suppress(Exception):
                fmpy.freeLibrary(handle)
