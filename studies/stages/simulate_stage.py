"""Stages that ask the physical model for data: the simulated sets and the Sobol indices."""

from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.joined_store import store_at
from studies.console import Column
from studies.physical_model import open_physical_model, say_reused, store_file
from studies.profile import Profile
from studies.report.wording import count
from studies.row_set import RowSet
from studies.sobol import SobolIndices, sobol_indices
from studies.stages.pipeline import Outcome, Stage, Study, digest_of
from studies.stages.stage_results import SimulatedSets
from studies.stages.stage_runs import log_sensitivity

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
    return {"train": train_seed(profile.seed), "validation": VALIDATION_SEED, "test": TEST_SEED}


def set_sizes(profile: Profile) -> dict[str, int]:
    """Return the rows of each set."""
    data = profile.data
    return {"train": max(data.n_train), "validation": data.n_validation, "test": data.n_test}


def _designs(study: Study) -> dict[str, FloatArray]:
    """Return the parameters of each set. Shape (n, p) each. [per parameter]."""
    space, seeds = study.case.parameter_space, set_seeds(study.profile)
    return {name: uniform_design(space, n, seeds[name]) for name, n in set_sizes(study.profile).items()}


def simulate_stage(study: Study) -> Outcome[SimulatedSets]:
    """Simulate the nested training design, the validation and the test set."""
    sizes, designs = set_sizes(study.profile), _designs(study)
    total, store = sum(sizes.values()), store_file(study.paths, study.case)
    inputs = {
        "case": study.case.digest,
        "n": sizes,
        "seeds": set_seeds(study.profile),
        "design": "uniform",
    }
    what = f"{total} simulations ({', '.join(f'{n} {name}' for name, n in sizes.items())})"
    stage = Stage(study, "simulate", what, inputs, SimulatedSets)
    sets = {name: RowSet(theta, store, _set_file(study, name, theta)) for name, theta in designs.items()}

    def simulate() -> SimulatedSets:
        with open_physical_model(study) as model, study.console.progress("simulations", total) as advance:
            theta = np.concatenate([*designs.values()])
            model.complete(theta, on_progress=lambda n_done: advance(n_done, total))
        for rows in sets.values():
            rows.save()
        say_reused(study, "simulate", model)
        answers = {name: rows.read() for name, rows in sets.items()}
        n_failed = {name: int(answer.failed.sum()) for name, answer in answers.items()}
        first = tuple(sorted({reason for one in answers.values() for reason in one.failures if reason})[:3])
        if first:
            how_many, why = count(sum(n_failed.values()), "simulation"), "; ".join(first)
            study.console.warn(f"{how_many} failed, left out: {why} (--retry-failed repeats them)")
        return SimulatedSets(
            n=sizes,
            n_failed=n_failed,
            first_failures=first,
            files={name: study.paths.recorded(rows.file) for name, rows in sets.items()},
            digests={name: answer.digest for name, answer in answers.items()},
            store=study.paths.recorded(store),
            n_reused=model.n_reused,
        )

    return stage.once(simulate, again=missing_rows(study)[0] > 0, files=[rows.file for rows in sets.values()])


def missing_rows(study: Study) -> tuple[int, int]:
    """Return how many rows of all sets are not stored yet, and how many there are."""
    designs = _designs(study).values()
    total = sum(map(len, designs))
    try:
        with store_at(store_file(study.paths, study.case)) as store:
            return total - sum(int(store.find(theta).sum()) for theta in designs), total
    except InputError:
        return total, total


def _set_file(study: Study, name: str, theta: FloatArray) -> Path:
    identity = digest_of({"case": study.case.digest, "set": name, "theta": theta.tobytes().hex()})
    return study.paths.generated(study.case.name) / "sets" / f"{name}-n{len(theta):05d}-{identity[:12]}.npz"


def show_sets(study: Study, found: SimulatedSets) -> None:
    """Print the simulated sets."""
    paths = study.paths
    study.console.table(
        f"{study.label}: simulations",
        [Column("set"), Column("rows", True), Column("failed", True), Column("file")],
        [
            [name, found.n[name], found.n_failed[name], paths.show(file)]
            for name, file in set_files(study, found).items()
        ],
    )
    store = paths.show(paths.root / found.store)
    study.console.result(f"all simulations: {store} (`studies simulate --help` shows how to read them)")


def set_files(study: Study, found: SimulatedSets) -> dict[str, Path]:
    """Return the files of a finished simulate stage's sets."""
    return {name: study.paths.root / file for name, file in found.files.items()}


def sensitivity_stage(study: Study) -> Outcome[SobolIndices]:
    """Estimate the Sobol indices of the physical model."""
    budget = study.profile.sensitivity
    n_rows = budget.n_base * (study.case.parameter_space.n_parameters + 2)
    inputs = {
        "case": study.case.digest,
        "n_base": budget.n_base,
        "n_resamples": budget.n_resamples,
        "seed": study.profile.seed,
    }
    stage = Stage(
        study,
        "sensitivity",
        f"Sobol indices from {n_rows} simulations",
        inputs,
        SobolIndices,
        {"kind": "sensitivity"},
    )

    def estimate() -> SobolIndices:
        with open_physical_model(study) as model, study.console.progress("simulations", n_rows) as advance:
            indices = sobol_indices(
                model,
                n_base=budget.n_base,
                seed=study.profile.seed,
                n_resamples=budget.n_resamples,
                on_progress=advance,
            )
        say_reused(study, "sensitivity", model)
        if not study.paths.tracking_database.is_file():
            study.console.say("sensitivity: making MLflow's store, once")
        return indices

    return stage.once(estimate, log=log_sensitivity)
