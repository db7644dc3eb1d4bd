"""How long a simulation of a case takes, as whoever simulated last has measured it, and what many take."""

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from simulation.errors import InputError
from simulation.record_file import read_json, write_json
from studies.paths import ProjectPaths
from studies.task import Task
from studies.words.console import format_seconds
from studies.words.wording import significant

if TYPE_CHECKING:
    from pathlib import Path

    from simulation.case import Case


class Timed(NamedTuple):
    """What a simulation takes.

    Attributes:
        simulation_s: The simulation, of all experiments together. [s]
        opening_s: A process that opens the model; 0 where that was not measured. [s]
    """

    simulation_s: float
    opening_s: float = 0.0


def note_time(paths: ProjectPaths, case: "Case", timed: Timed) -> None:
    """Keep what a simulation of a case took; nothing is kept where none was timed."""
    if timed.simulation_s > 0.0:
        file = _file(paths, case)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, timed._asdict())


def known_time(paths: ProjectPaths, case: "Case") -> Timed | None:
    """Return what a simulation of a case took when it was last timed, None where it never was."""
    with suppress(InputError, TypeError, ValueError):  # it is made again by the next simulation
        kept = read_json(_file(paths, case)) or {}
        timed = Timed(*(float(kept.get(name, 0.0)) for name in Timed._fields))
        return timed if timed.simulation_s > 0.0 else None
    return None


def _file(paths: ProjectPaths, case: "Case") -> "Path":
    return paths.generated(case.name) / "simulations" / f"{case.model_digest[:16]}.time.json"


def duration(task: Task, n: int, n_at_once: int | None = None) -> str:
    """Return how long simulations take, as a part of a sentence; "" where none was timed, or none is left.

    Args:
        task: the task.
        n: how many.
        n_at_once: how many run at once, each in a process of its own; None for all that share processes.
    """
    timed = known_time(task.paths, task.case) if n else None
    if timed is None:
        return ""
    each_s = timed.simulation_s + (0.0 if n_at_once is None else timed.opening_s)
    return f", about {shown_time(n * each_s / (n_at_once or task.n_jobs))} to simulate"


def shown_time(seconds: float) -> str:
    """Write a duration; a short one in milliseconds."""
    return f"{significant(1000.0 * seconds)} ms" if 0.0 < seconds < 1.0 else format_seconds(seconds)
