"""What processes of an executor do, perhaps on a machine without our files: they have chunks simulated."""

import pickle
import threading
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from simulation.arrays import FloatArray
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.factory import Facts
from simulation.pool.processes import Processes
from simulation.pool.worker_process import ChunkAnswer

FILES: dict[str, Path] = {}
"""Where models' files lie that were sent to this machine, by SHA-256 of their content."""
# A thread keeps this many models open: each may hold a licence.
_KEPT_MODELS = 2
# Of each thread, the last one used at the end.
_kept = threading.local()


@dataclass(frozen=True)
class RemoteModel:
    """A model on its way to another process.

    Attributes:
        make_model: Its factory, pickled.
        digest: SHA-256 of the content of its file, in hexadecimal; "" where that is used where it is.
        policy: What happens to rows that hang, crash or fail.
    """

    make_model: bytes
    digest: str
    policy: ExecutionPolicy

    def simulate(self, theta: FloatArray, budget_s: float, slowest_s: float | None) -> ChunkAnswer | Facts:
        """Simulate rows in a supervised process of the machine that this is called on.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            budget_s: Time after which no further row is begun. [s]
            slowest_s: See ExecutionPolicy.limit_s. [s]

        Returns:
            See Processes.simulate.
        """
        return self._processes().simulate(theta, budget_s, slowest_s)

    def _processes(self) -> Processes:
        # Not above: the traceback of an error there would keep the processes of all models alive.
        kept: OrderedDict[RemoteModel, Processes] = vars(_kept).setdefault("models", OrderedDict())
        if self not in kept:
            while len(kept) >= _KEPT_MODELS:
                kept.popitem(last=False)[1].close()
            make_model: Any = pickle.loads(self.make_model)
            if self.digest:
                owner = replace(make_model.__self__, path=FILES[self.digest])
                make_model = getattr(owner, make_model.__name__)
            kept[self] = Processes(make_model, self.policy)
        kept.move_to_end(self)
        return kept[self]
