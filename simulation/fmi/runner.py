"""What a solver promises, and what only another process can do."""

from typing import Protocol

from simulation.arrays import FloatArray


class NeedsFreshProcess(RuntimeError):  # noqa: N818 (says what is to be done, not what went wrong)
    """The row at hand cannot be simulated in this process, and could be in a new one.

    Raised where an FMU ended with a fatal error (the standard then calls every instance of the process
    corrupt), where it refuses a second instance, or where not even a second instance answers like the first.
    No result was handed out for the row; rows before it are good. Whoever supervises the process ends it,
    starts another and hands it the row again. A process that raises this before it has answered any row was
    no use; whoever supervises it gives up after some of them.
    """


class FmuProcessEnded(RuntimeError):  # noqa: N818 (says what has happened)
    """The FMU ended the process that it has of its own, with the row at hand.

    Attributes:
        exit_code: What the process ended with, or minus the signal that killed it.
    """

    def __init__(self, exit_code: int) -> None:
        super().__init__(f"the FMU ended its process with exit code {exit_code}")
        self.exit_code = exit_code


class Solver(Protocol):
    """Takes an instance that is as if just instantiated through one row, by one interface."""

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Set the parameters, initialize, and step to the end.

        Args:
            values: The calibrated parameters. Shape (p,). [FMU's units]
            y: Filled with the outputs, contiguous. Shape (n_warmup + t, k). [FMU's units]

        Returns:
            Why the row failed, in one line; "" when it is good. After a failure the instance is replaced.
        """
        ...
