"""What the functions of an FMU return, and what that means for its instance, wherever that lives."""

from abc import ABC, abstractmethod
from pathlib import Path

from simulation.errors import InputError
from simulation.fmi.log import last_message
from simulation.fmi.runner import NeedsFreshProcess
from simulation.fmi.variable import FmiVersion

# Values of fmi2Status and fmi3Status.
OK = 0
WARNING = 1
DISCARD = 2
FATAL = 4
_STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

# What FMI 2.0 calls otherwise; everything here has FMI 3.0's names.
_IN_FMI2 = {
    "GetFloat64": "GetReal",
    "UpdateDiscreteStates": "NewDiscreteStates",
    "GetContinuousStateDerivatives": "GetDerivatives",
}


class Instance(ABC):
    """The one instance of an FMU, which may be replaced by a new one.

    Functions have the names of FMI 3.0 without the version: "DoStep" is fmi2DoStep or fmi3DoStep. A status
    above WARNING makes the instance damaged: it is to be replaced before it is used again.

    Attributes:
        version: FMI version.
        prefix: "fmi2" or "fmi3".
        damaged: Whether the instance is to be replaced before it is used again.
        lost: Whether the FMU said that no instance of the process can be used again.
    """

    def __init__(self, path: Path, version: FmiVersion) -> None:
        """Set up.

        Args:
            path: The FMU, for messages.
            version: Its FMI version.
        """
        self._path = path
        self.version = version
        self.prefix = "fmi2" if version == "2.0" else "fmi3"
        self.damaged = self.lost = False

    @abstractmethod
    def reset(self) -> bool:
        """Ask the FMU to be as if just instantiated.

        Returns:
            Whether it says that it is.
        """

    @abstractmethod
    def replace(self) -> None:
        """Free the instance and make a new one.

        Raises:
            NeedsFreshProcess: If the FMU said that all is lost, or makes no second instance in this process.
        """

    @abstractmethod
    def close(self) -> None:
        """Free the instance and unload the library; closing twice does no harm."""

    def full_name(self, name: str) -> str:
        """Return the name of a function as the library has it: "DoStep" gives "fmi2DoStep"."""
        return self.prefix + (_IN_FMI2.get(name, name) if self.prefix == "fmi2" else name)

    def failure(self, name: str, status: int, time: float) -> str:
        """Return why a call failed, and mark the instance as damaged.

        Args:
            name: Function that was called, without the version.
            status: What it returned.
            time: Simulated time of the call. [s]

        Returns:
            One line.
        """
        self.damaged = True
        # A status that no version of the standard has is taken for fatal.
        self.lost = self.lost or status == FATAL or status >= len(_STATUS)
        known = f"{self.prefix}{_STATUS[status]}" if 0 <= status < len(_STATUS) else f"status {status}"
        return f"{self.full_name(name)} returned {known} at {time:g} s{last_message(': {}')}"

    def not_loaded(self, why: str) -> InputError:
        """Return the error for a library that cannot be loaded."""
        return InputError(f"{self._path}: cannot be loaded ({why})")

    def no_function(self, full_name: str) -> InputError:
        """Return the error for a library without a function."""
        return InputError(f"{self._path}: its binary has no function {full_name}; export it again")

    def refusal(self) -> InputError:
        """Return the error for a first instance that the FMU did not make."""
        said = last_message(" ({})")
        return InputError(
            f"{self._path}: the FMU refuses to be instantiated{said}; try it in another FMI tool"
        )

    def no_other(self) -> NeedsFreshProcess:
        """Return the error for a second instance that the FMU did not make, or could not be asked for."""
        if self.lost:
            return NeedsFreshProcess(
                f"{self._path}: after {self.prefix}Fatal no instance of this process can be used"
            )
        said = last_message(" ({})")
        return NeedsFreshProcess(f"{self._path}: the FMU makes no second instance in one process{said}")
