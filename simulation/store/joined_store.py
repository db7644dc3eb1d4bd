"""The rows of several experiments as those of one store: each lies in the store of its own model."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any, Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import InputError
from simulation.experiments import JoinedModel
from simulation.layout import Experiment, Layout
from simulation.pool.pool_model import PoolModel
from simulation.pool.worker_process import NewProcess
from simulation.record_file import read_json, write_json
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories

_REMEDY = "remove it, and studies simulate makes it anew"


class JoinedStore(SimulationStore):
    """Keeps rows of several experiments; a row is stored where all its parts are.

    It has no database of its own: its file names the stores of the experiments, relative to its own place.
    """

    def __init__(self, file: Path, stores: Sequence[SimulationStore], layout: Layout) -> None:
        """Take open stores.

        Args:
            file: Where the names of the stores lie.
            stores: The open stores of all experiments.
            layout: How their rows become one.
        """
        self.file = Path(file)
        self.stores = tuple(stores)
        self.layout = layout
        self.names, self.time = (layout.parameter_names, layout.output_names), layout.time

    @classmethod
    def at(cls, file: Path) -> Self:
        """Open a store that exists.

        Args:
            file: What `save` wrote.

        Raises:
            InputError: If there is none, it is damaged, or one of the experiments' stores is missing.
        """
        content = read_json(Path(file), _REMEDY)
        if content is None:
            raise InputError(f"{file}: no simulations are stored there; type: studies simulate")
        parts = content["experiments"]
        layout = Layout(
            tuple(content["parameters"]),
            tuple(content["outputs"]),
            np.array(content["time_s"]),
            tuple(
                Experiment(
                    one["name"],
                    np.array(one["parameters"], dtype=np.int64),
                    np.array(one["outputs"], dtype=np.int64),
                    one["n_times"],
                )
                for one in parts
            ),
        )
        with ExitStack() as opened:
            stores = [
                opened.enter_context(SimulationStore.at(Path(file).parent / one["store"])) for one in parts
            ]
            opened.pop_all()
        return cls(file, stores, layout)

    def save(self) -> None:
        """Write which stores these are; nothing where it is written already, and whole."""
        layout = self.layout
        content: dict[str, Any] = {
            "parameters": [*layout.parameter_names],
            "outputs": [*layout.output_names],
            "time_s": layout.time.tolist(),
            "experiments": [
                {
                    "name": one.name,
                    "store": Path(os.path.relpath(store.file, self.file.parent)).as_posix(),
                    "parameters": one.parameters.tolist(),
                    "outputs": one.outputs.tolist(),
                    "n_times": one.n_times,
                }
                for one, store in zip(layout.experiments, self.stores, strict=True)
            ],
        }
        with suppress(InputError):  # what is damaged is written anew
            if read_json(self.file) == content:
                return
        write_json(self.file, content)

    @property
    def theta(self) -> FloatArray:
        """Parameters of rows that all experiments have. Shape (n, p). [per parameter].

        What an experiment has of its own is taken as it was written, beside others of the same shared values.
        """
        known: dict[bytes, list[FloatArray]] = {}
        columns = [set(one.parameters.tolist()) for one in self.layout.experiments]
        shared = sorted(set.intersection(*columns))
        for place, (one, store) in enumerate(zip(self.layout.experiments, self.stores, strict=True)):
            where = [int(np.flatnonzero(one.parameters == column)[0]) for column in shared]
            for theta in store.theta:
                parts = known.setdefault(theta[where].tobytes(), [])
                if len(parts) == place:
                    parts.append(theta)
        whole = [parts for parts in known.values() if len(parts) == len(self.stores)]
        joined = np.empty((len(whole), len(self.layout.parameter_names)))
        for row, parts in enumerate(whole):
            for one, theta in zip(self.layout.experiments, parts, strict=True):
                joined[row, one.parameters] = theta
        return joined

    @property
    def n_written(self) -> int:
        """Number of the rows that were written, of all experiments."""
        return sum(store.n_written for store in self.stores)

    def parts(self, theta: FloatArray) -> list[tuple[SimulationStore, FloatArray]]:
        """Return each experiment's store and own parameters. Shapes (n, p) and (n, q). [per parameter]."""
        parts = zip(self.layout.experiments, self.stores, strict=True)
        return [(store, self.layout.theta_of(one, theta)) for one, store in parts]

    def find(self, theta: FloatArray, *, failed_after: int = 0) -> BoolArray:
        """Return which rows all experiments have, see `SimulationStore.find`."""
        found = [store.find(own, failed_after=failed_after) for store, own in self.parts(theta)]
        return np.asarray(np.all(found, axis=0))

    def read(self, theta: FloatArray) -> Trajectories:
        """Read rows, see `SimulationStore.read`."""
        answers = [store.read(own) for store, own in self.parts(theta)]
        return self.layout.join(np.array(theta, dtype=np.float64), answers)

    def first(self, theta: FloatArray) -> BoolArray:
        """Return which rows were the first of their process in all experiments."""
        return np.asarray(np.all([store.first(own) for store, own in self.parts(theta)], axis=0))

    @property
    def is_reuse_given_up(self) -> bool:
        """Whether rows of one process were found to depend on each other in an experiment."""
        return any(store.is_reuse_given_up for store in self.stores)

    def give_up_reuse(self) -> int:
        """Remove all rows that shared a process, see `SimulationStore.give_up_reuse`."""
        return sum([store.give_up_reuse() for store in self.stores])

    def append(self, rows: Trajectories, is_first: BoolArray | None = None) -> None:
        """Store rows, part by part: what an experiment has already is not written again."""
        first = np.ones(rows.n, dtype=np.bool_) if is_first is None else is_first
        for one, store in zip(self.layout.experiments, self.stores, strict=True):
            parts = self.layout.part(one, rows, store.names, store.time)
            is_new = ~store.find(parts.theta) | (~store.find_good(parts.theta) & ~parts.failed)
            store.append(parts.take(is_new), first[is_new])

    def close(self) -> None:
        """Close the stores."""
        for store in self.stores:
            store.close()


def store_at(file: Path) -> SimulationStore:
    """Open a store that exists, of one model or of several experiments.

    Args:
        file: Where it lies.

    Raises:
        InputError: If there is none.
    """
    return JoinedStore.at(file) if Path(file).suffix == ".json" else SimulationStore.at(file)


class StoredExperiments(StoredModel):
    """Several experiments around their stores: a row that an experiment has is not simulated in it again.

    The experiments that a row lacks are simulated side by side.
    """

    def __init__(self, model: JoinedModel, store: JoinedStore, *, retry_failed: bool = False) -> None:
        """Wrap a model.

        Args:
            model: The model to ask; its rows come from a pool.
            store: Where its answers lie.
            retry_failed: Ask again, once, for rows that failed before this object was made.
        """
        pool = model.model if isinstance(model.model, PoolModel) else None
        super().__init__(model, store, retry_failed=retry_failed, pool=pool)
        self._joined, self._joined_store = model, store
        self._retry = [one.n_written if retry_failed else 0 for one in store.stores]

    def missing(self, theta: FloatArray) -> BoolArray:
        """Return which rows lack an experiment. Shapes (n, p) and (n,)."""
        return np.asarray(np.any([self._missing(place, theta) for place in self._places], axis=0))

    @property
    def _places(self) -> range:
        return range(len(self._joined_store.stores))

    def _missing(self, place: int, theta: FloatArray) -> BoolArray:
        store, own = self._joined_store.parts(theta)[place]
        return ~store.find(own, failed_after=self._retry[place])

    def complete(
        self, theta: FloatArray, *, on_progress: Callable[[int], None] = lambda n_done: None
    ) -> None:
        """Simulate what is not stored, and store each part of a row as it finishes.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            on_progress: Called with the number of rows that are stored so far.
        """
        theta = np.array(theta, dtype=np.float64)
        lacking = {place: self._missing(place, theta) for place in self._places}
        n_new = int(np.any([*lacking.values()], axis=0).sum())
        self.n_reused += len(theta) - n_new
        self.n_simulated += n_new
        self._complete(theta, lacking, on_progress)

    def simulate_alone(self, theta: FloatArray, place: int) -> Trajectories:
        """Return rows of one experiment, as its own model would; those that are not stored are simulated.

        Args:
            theta: Parameters of all experiments. Shape (n, p). [per parameter]
            place: Which experiment.
        """
        theta = np.array(theta, dtype=np.float64)
        self._complete(theta, {place: self._missing(place, theta)})
        store, own = self._joined_store.parts(theta)[place]
        return store.read(own)

    def _complete(
        self,
        theta: FloatArray,
        lacking: Mapping[int, BoolArray],
        on_progress: Callable[[int], None] = lambda n_done: None,
    ) -> None:
        """Simulate and store the rows that experiments lack, by their places."""
        rows, wanted = self._joined.rows, list[FloatArray]()
        for place, is_missing in lacking.items():
            own = rows.layout.experiments[place].parameters
            # Each missing part once, by the exact bytes of the experiment's own parameters.
            parts = {row[own].tobytes(): row for row in theta[is_missing]}
            wanted.append(rows.rows(np.array([*parts.values()]).reshape(-1, theta.shape[1]), place))
        asked = np.concatenate(wanted)
        n_stored = len(theta) * len(lacking) - len(asked)
        on_progress(n_stored // len(lacking))
        pool = self._pool
        assert pool is not None, "rows of experiments come from a pool"
        with closing(pool.as_finished(asked)) as chunks:
            for _, chunk, is_first in chunks:
                answered = chunk.theta[:, 0].astype(np.int64)
                for place in np.unique(answered):
                    part = rows.answer(chunk.take(answered == place), int(place))
                    self._joined_store.stores[place].append(part, is_first[answered == place])
                n_stored += chunk.n
                on_progress(n_stored // len(lacking))
                self._count_reused(is_first)
        if self.reuse.is_open:
            self._check_reuse()

    def _check_reuse(self) -> None:
        """Repeat rows of each experiment; the process that simulates them changes with the experiment."""
        for place, store in enumerate(self._joined_store.stores):
            reused = store.theta_reused
            chosen = reused[self.reuse.chosen(len(reused))]
            if len(chosen) and not self._is_repeated(chosen, place):
                self.give_up_reuse()
        self.reuse.checked()

    def _is_repeated(self, own: FloatArray, place: int, *, is_first: bool = False) -> bool:
        rows = self._joined.rows
        columns = rows.layout.experiments[place].parameters

        def anew(own: FloatArray, new_process: NewProcess) -> Trajectories:
            theta = np.zeros((len(own), len(rows.layout.parameter_names)))
            theta[:, columns] = own
            return rows.answer(self._anew(rows.rows(theta, place), new_process), place)

        stored = self._joined_store.stores[place].read(own)
        return self.reuse.is_repeated(anew, stored, is_first=is_first)

    def repeats(self, theta: FloatArray) -> bool:
        """Repeat a stored row in all experiments, see `StoredModel.repeats`."""
        for place in self._places:
            store, own = self._joined_store.parts(theta[None])[place]
            if not self._is_repeated(own, place, is_first=bool(store.first(own)[0])):
                self.give_up_reuse()
        return not self.reuse.is_random
