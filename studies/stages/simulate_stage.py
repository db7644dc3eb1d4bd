"""The stage that asks the physical model for the sets that surrogates are trained on and judged by."""

from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.joined_store import store_at
from studies.physical_model import open_physical_model, say_reused, store_file
from studies.profile import Profile
from studies.results.outcome import Outcome, digest_of
from studies.results.row_set import RowSet
from studies.results.stage_results import SimulatedSets
from studies.simulation_time import duration
from studies.stages.pipeline import Stage
from studies.task import Task
from studies.words.console import Column
from studies.words.wording import count

VALIDATION_SEED, TEST_SEED = 320_001, 320_002
"""Validation and test sets are the same for every profile and seed, so that all errors can be compared."""
TRAIN_SEED_BASE = 1_000


def train_seed(seed: int) -> int:
    """Return the seed of the training design, never that of a set that judges.

    Args:
        seed: the study's seed.
    """
    own = TRAIN_SEED_BASE + seed
    return own if own < VALIDATION_SEED else own + 2


def set_seeds(profile: Profile) -> dict[str, int]:
    """Return the seed of each set's design."""
    seeds = {"train": train_seed(profile.seed), "validation": VALIDATION_SEED, "test": TEST_SEED}
    return {name: seeds[name] for name in profile.data.sets}


def train_design(task: Task, n: int) -> FloatArray:
    """Return the first rows of the training design. Shape (n, p). [per parameter]."""
    return uniform_design(task.case.parameter_space, n, train_seed(task.profile.seed))


def _designs(task: Task) -> dict[str, FloatArray]:
    """Return the parameters of each set. Shape (n, p) each. [per parameter]."""
    space, seeds = task.case.parameter_space, set_seeds(task.profile)
    return {name: uniform_design(space, n, seeds[name]) for name, n in task.profile.data.sets.items()}


def simulate_stage(task: Task) -> Outcome[SimulatedSets]:
    """Simulate the nested training design, the validation and the test set."""
    sizes, designs = task.profile.data.sets, _designs(task)
    total, store = sum(sizes.values()), store_file(task.paths, task.case)
    inputs = {
        "case": task.case.digest,
        "n": sizes,
        "seeds": set_seeds(task.profile),
        "design": "uniform",
    }
    n_missing = missing_rows(task)[0]
    what = f"{total} simulations ({', '.join(f'{n} {name}' for name, n in sizes.items())})"
    what += duration(task, n_missing)
    stage = Stage(task, "simulate", what, inputs, SimulatedSets)
    sets = {name: RowSet(theta, store, _set_file(task, name, theta)) for name, theta in designs.items()}

    def simulate() -> SimulatedSets:
        with open_physical_model(task) as model, task.console.progress("simulations", total) as advance:
            theta = np.concatenate([*designs.values()])
            model.complete(theta, on_progress=lambda n_done: advance(n_done, total))
        for rows in sets.values():
            rows.save()
        say_reused(task, "simulate", model)
        answers = {name: rows.read() for name, rows in sets.items()}
        n_failed = {name: int(answer.failed.sum()) for name, answer in answers.items()}
        first = tuple(sorted({reason for one in answers.values() for reason in one.failures if reason})[:3])
        if first:
            how_many, why = count(sum(n_failed.values()), "simulation"), "; ".join(first)
            task.console.warn(f"{how_many} failed, left out: {why} (--retry-failed repeats them)")
        return SimulatedSets(
            n=sizes,
            n_failed=n_failed,
            first_failures=first,
            files={name: task.paths.recorded(rows.file) for name, rows in sets.items()},
            digests={name: answer.digest for name, answer in answers.items()},
            store=task.paths.recorded(store),
            n_reused=model.n_reused,
        )

    return stage.once(simulate, again=n_missing > 0, files=[rows.file for rows in sets.values()])


def missing_rows(task: Task) -> tuple[int, int]:
    """Return how many rows of all sets are not stored yet, and how many there are."""
    designs = _designs(task).values()
    total = sum(map(len, designs))
    try:
        with store_at(store_file(task.paths, task.case)) as store:
            return total - sum(int(store.find(theta).sum()) for theta in designs), total
    except InputError:
        return total, total


def _set_file(task: Task, name: str, theta: FloatArray) -> Path:
    identity = digest_of({"case": task.case.digest, "set": name, "theta": theta.tobytes().hex()})
    return task.paths.generated(task.case.name) / "sets" / f"{name}-n{len(theta):05d}-{identity[:12]}.npz"


def show_sets(task: Task, found: SimulatedSets) -> None:
    """Print the simulated sets."""
    paths = task.paths
    task.console.table(
        f"{task.label}: simulations",
        [Column("set"), Column("rows", True), Column("failed", True), Column("file")],
        [
            [name, found.n[name], found.n_failed[name], paths.show(file)]
            for name, file in set_files(task, found).items()
        ],
    )
    store = paths.show(paths.root / found.store)
    task.console.result(f"all simulations: {store} (`studies simulate --help` shows how to read them)")


def set_files(task: Task, found: SimulatedSets) -> dict[str, Path]:
    """Return the files of a finished simulate stage's sets."""
    return {name: task.paths.root / file for name, file in found.files.items()}
