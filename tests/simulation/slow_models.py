"""Models for the tests of processes: slow ones, and ones that do to their process what broken FMUs do."""

import os
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from toy_rc import ToyRC

from simulation import InputError, Trajectories
from simulation.file_lock import FileLock

BAD_ABOVE_R = 4.0


@dataclass(frozen=True, eq=False)
class SlowToy(ToyRC):
    """The RC toy, each row held up for a while; keeps a record of the rows that were begun."""

    row_s: float = 0.05
    begun: Path | None = None

    def open(self) -> "SlowToy":
        return self

    def simulate(self, theta: np.ndarray) -> Trajectories:
        if self.begun is not None:
            with self.begun.open("ab", buffering=0) as file:
                file.write(b"".join(row.tobytes().hex().encode() + b"\n" for row in theta))
        time.sleep(self.row_s * len(theta))
        bad = theta[:, 0] > BAD_ABOVE_R
        if bad.any():
            self.misbehave(theta)
        return super().simulate(theta)

    def misbehave(self, theta: np.ndarray) -> None:
        """Do something with rows whose R is above 4 K/W."""


@dataclass(frozen=True, eq=False)
class CrashingToy(SlowToy):
    row_s: float = 0.0
    words: str = "about to fall"

    def misbehave(self, theta: np.ndarray) -> None:
        print(self.words, file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGSEGV)
        time.sleep(10)


@dataclass(frozen=True, eq=False)
class OnceCrashingToy(CrashingToy):
    """Falls once in the life of its folder, and never again."""

    folder: Path = Path()

    def misbehave(self, theta: np.ndarray) -> None:
        if not (self.folder / "fell").exists():
            (self.folder / "fell").touch()
            super().misbehave(theta)


@dataclass(frozen=True, eq=False)
class ExitingToy(SlowToy):
    row_s: float = 0.0
    exit_code: int = 3

    def misbehave(self, theta: np.ndarray) -> None:
        os._exit(self.exit_code)


@dataclass(frozen=True, eq=False)
class HangingToy(SlowToy):
    row_s: float = 0.0

    def misbehave(self, theta: np.ndarray) -> None:
        time.sleep(1e6)


@dataclass(frozen=True, eq=False)
class RaisingToy(SlowToy):
    row_s: float = 0.0
    error: type[Exception] = ValueError

    def misbehave(self, theta: np.ndarray) -> None:
        raise self.error("R is\ntoo large")


@dataclass(frozen=True, eq=False)
class PickyToy(SlowToy):
    """Opens only once at a time, like an FMU with one licence, or never."""

    row_s: float = 0.02
    licence: Path | None = None
    held: list[FileLock] = field(default_factory=list)

    def open(self) -> "PickyToy":
        if self.licence is None:
            raise InputError("picky.fmu: there is no licence; ask for one")
        lock = FileLock(self.licence)
        if not lock.try_acquire():
            raise InputError("picky.fmu: the licence is taken; wait for it")
        self.held.append(lock)
        return self

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "held": []}


@dataclass(frozen=True, eq=False)
class DyingAtOpeningToy(SlowToy):
    def open(self) -> "DyingAtOpeningToy":
        os.kill(os.getpid(), signal.SIGABRT)
        return self


def rows_of(n: int, n_bad: int = 0) -> np.ndarray:
    """Return rows of which some, here and there, have an R that misbehaves."""
    rng = np.random.default_rng(5)
    rows = ToyRC().parameter_space.from_unit(rng.random((n, 2)))
    rows[:, 0] = np.minimum(rows[:, 0], BAD_ABOVE_R)
    rows[rng.choice(n, n_bad, replace=False), 0] = 4.5
    return rows


def count_begun(file: Path) -> dict[str, int]:
    """Return how often each row was begun, by the bytes of its parameters."""
    counts: dict[str, int] = {}
    for line in file.read_text().split():
        counts[line] = counts.get(line, 0) + 1
    return counts
