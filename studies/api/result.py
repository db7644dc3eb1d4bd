"""What functions return: a task, and what its stages came to."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from studies.results.outcome import Outcome

if TYPE_CHECKING:
    from studies.task import Task

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Result(Generic[T]):
    """What one stage came to.

    Attributes:
        task: Case, profile and project.
        outcome: Its result, and what made it.
    """

    task: "Task"
    outcome: Outcome[T]
