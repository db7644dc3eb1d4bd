"""Stages that ask the physical model for data: the simulated sets and the Sobol indices."""

from collections.abc import Callable
from pathlib import Path

from simulation.arrays import FloatArray
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.joined_store import store_at
from studies.console import Column, OnProgress
from studies.physical_model import open_physical_model, say_reused, store_file
from studies.profile import Profile
from studies.provenance import provenance_of
from studies.report.wording import count
from studies.row_set import RowSet, content_of
from studies.sobol import SobolIndices, sobol_indices
from studies.stages.pipeline import Outcome, Stage, Study, digest_of
from studies.stages.stage_results import SimulatedSets

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
    sizes, total = set_sizes(study.profile), sum(set_sizes(study.profile).values())
    inputs = {
        "case": study.case.digest,
        "n": sizes,
        "seeds": set_seeds(study.profile),
        "design": "uniform",
    }

    if missing_rows(study)[0]:
        (study.results / "simulate.json").unlink(missing_ok=True)
    what = f"{total} simulations ({', '.join(f'{n} {name}' for name, n in sizes.items())})"
    stage = Stage(study, "simulate", what, inputs, SimulatedSets)
    before = stage.finished()
    if before is not None:
        return before
    with stage.work() as work:
        sets, digests, failed, n_done = dict[str, RowSet](), dict[str, str](), dict[str, list[str]](), 0
        with open_physical_model(study) as model, study.console.progress("simulations", total) as advance:
            for name, theta in _designs(study).items():
                model.complete(theta, on_progress=_after(n_done, total, advance))
                n_done += len(theta)
                sets[name] = RowSet(theta, model.store.file, _set_file(study, name, theta))
                sets[name].save()
                digests[name], reasons = content_of(model.store.stream(theta))
                failed[name] = [reason for reason in reasons if reason]
        say_reused(study, "simulate", model)
        first = tuple(sorted({reason for reasons in failed.values() for reason in reasons})[:3])
        if n_failed := sum(map(len, failed.values())):
            how_many, why = count(n_failed, "simulation"), "; ".join(first)
            study.console.warn(f"{how_many} failed, left out: {why} (--retry-failed repeats them)")
        found = SimulatedSets(
            n=sizes,
            n_failed={name: len(reasons) for name, reasons in failed.items()},
            first_failures=first,
            files={name: study.paths.recorded(rows.file) for name, rows in sets.items()},
            digests=digests,
            store=study.paths.recorded(store_file(study.paths, study.case)),
            n_reused=model.n_reused,
        )
        return work.keep(found, [rows.file for rows in sets.values()])


def missing_rows(study: Study) -> tuple[int, int]:
    """Return how many rows of all sets are not stored yet, and how many there are."""
    designs = _designs(study).values()
    total = sum(map(len, designs))
    try:
        with store_at(store_file(study.paths, study.case)) as store:
            return total - sum(int(store.find(theta).sum()) for theta in designs), total
    except InputError:
        return total, total


def _after(before: int, total: int, advance: OnProgress) -> Callable[[int], None]:
    return lambda n_done: advance(before + n_done, total)


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
    stage = Stage(study, "sensitivity", f"Sobol indices from {n_rows} simulations", inputs, SobolIndices)
    before = stage.finished()
    if before is not None:
        return before
    # MLflow takes seconds to import, which a dry run and the sets of simulations do without.
    from studies.stages.stage_runs import log_sensitivity

    with stage.work() as work:
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
        made = provenance_of(study, "sensitivity")
        return work.keep(indices, provenance=made, log=log_sensitivity)
