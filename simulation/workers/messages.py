"""What is said between the process that wants rows, the nursery and the workers."""

from dataclasses import dataclass
from enum import Enum

from simulation.workers.recipe import Facts


@dataclass(frozen=True)
class Hire:
    """To the nursery: start a worker; its end of a connection follows."""

    worker: int


@dataclass(frozen=True)
class Fire:
    """To the nursery: kill a worker."""

    worker: int


@dataclass(frozen=True)
class Limits:
    """When a worker asks to be replaced, and when it ends itself; see ExecutionPolicy."""

    max_growth_mb: float
    max_rows: int | None
    opening_s: float | None


@dataclass(frozen=True)
class Task:
    """To the nursery: import what a model needs, and have workers from now on.

    Attributes:
        recipe: The model's recipe, packed.
        limits: Of the workers.
        environment: Variables that they shall see.
        folder: Where relative paths begin; None where that has been removed.
    """

    recipe: bytes
    limits: Limits
    environment: dict[str, str]
    folder: str | None


@dataclass(frozen=True)
class Ready:
    """From the nursery: everything is imported."""


@dataclass(frozen=True)
class Rest:
    """To the nursery: the task is done; wait for another.

    Attributes:
        patience_s: How long. [s]
    """

    patience_s: float


@dataclass(frozen=True)
class Rested:
    """From the nursery: nothing of the task is left."""


@dataclass(frozen=True)
class Learnt:
    """From a worker, then to the nursery: what workers after it need not find out."""

    known: bytes


@dataclass(frozen=True)
class Hired:
    """From the nursery: a worker has started."""

    worker: int
    pid: int


@dataclass(frozen=True)
class Ended:
    """From the nursery: a worker has ended, with all processes that it started.

    Attributes:
        worker: Its number.
        exit_code: Its exit code, or the negative number of the signal that killed it; None if unknown.
        last_line: The last line that it, or its FMU, wrote to the terminal.
        out_of_memory: Whether the system killed it, or some process at that time, for want of memory.
    """

    worker: int
    exit_code: int | None
    last_line: str = ""
    out_of_memory: bool = False


@dataclass(frozen=True)
class Opened:
    """From a worker: the model is open, and looks like this."""

    facts: Facts


@dataclass(frozen=True)
class Refused:
    """From the nursery or a worker: the model cannot be opened.

    Attributes:
        line: Why.
        kind: The exception that says so: an InputError where the line is meant for the user.
    """

    line: str
    kind: type[Exception]


@dataclass(frozen=True)
class Run:
    """To a worker: simulate consecutive rows of an arena.

    Attributes:
        number: Its number; rows whose owner is another run by now are not to be begun.
        address: Where the arena is.
        arena: Its number; addresses are used again.
        start: The first row.
        stop: One after the last row.
        budget_s: Time after which no further row shall begin. [s]
    """

    number: int
    address: str
    arena: int
    start: int
    stop: int
    budget_s: float


class Why(Enum):
    """Why a run ended."""

    DONE = "all rows are finished"
    LATE = "the budget is spent; another process may take the rest"
    RECYCLE = "the process has grown or is old"
    FRESH = "the model can only go on in a new process"


@dataclass(frozen=True)
class Ran:
    """From a worker: a run has ended; rows of it that still wait can be given to another.

    Attributes:
        n_rows: Rows that were finished.
        spent_s: Time that they took. [s]
        why: Why the run ended.
    """

    n_rows: int
    spent_s: float
    why: Why

    @property
    def wants_rest(self) -> bool:
        """Whether the worker ends after this."""
        return self.why in (Why.RECYCLE, Why.FRESH)
