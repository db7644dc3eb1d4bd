"""Models for the tests of processes: slow ones, and ones that kill their process."""

import os
import time
from dataclasses import dataclass

import numpy as np

from simulation.toy import ToyRC
from simulation.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class SlowToy(ToyRC):
    """The RC toy, each row held up for a while; prints the process it runs in."""

    row_s: float = 0.05

    def simulate(self, theta: np.ndarray) -> Trajectories:
        time.sleep(self.row_s * len(theta))
        return super().simulate(theta)


@dataclass(frozen=True, eq=False)
class DeadlyToy(ToyRC):
    """The RC toy, which ends its process for R above 4 K/W, as a broken FMU does."""

    def simulate(self, theta: np.ndarray) -> Trajectories:
        if (theta[:, 0] > 4.0).any():
            os._exit(1)
        return super().simulate(theta)
