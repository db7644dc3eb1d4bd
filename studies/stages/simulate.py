"""Stages that ask the physical model for data: the simulated sets and the Sobol indices."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from studies.console import Column, OnProgress
from studies.physical_model import open_physical_model, say_reused, store_file
from studies.profile import Profile
from studies.recipe import recipe_of
from studies.report.wording import count
from studies.row_set import RowSet, SetContent, content_of
from studies.stages.pipeline import Outcome, Study, Summary, digest_of, run_stage
from studies.tracking.origin import environment

if TYPE_CHECKING:
    from studies.sensitivity import SobolIndices

VALIDATION_SEED, TEST_SEED = 320_001, 320_002
"""Validation and test sets are the same for every profile and seed, so that all errors can be compared."""
TRAIN_SEED_BASE = 1_000


@dataclass(frozen=True)
class SimulatedSet:
    """A set whose rows are all stored.

    Args:
        rows: which rows they are.
        content: what they came to.
    """

    rows: RowSet
    content: SetContent

    def n_failed(self, n: int | None = None) -> int:
        """Return the failed rows, those of the first n where asked."""
        return sum(reason != "" for reason in self.content.failures[:n])


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


def datasets_of(
    profile: Profile, n_train: int, digests: Mapping[str, str], files: Mapping[str, str] | None = None
) -> dict[str, dict[str, Any]]:
    """Return how the sets behind one surrogate are drawn, for a recipe.

    Args:
        profile: the budget.
        n_train: training-set size.
        digests: what each set came to.
        files: place of each set's file, where it is known.
    """
    n = {"train": n_train, "validation": profile.data.n_validation, "test": profile.data.n_test}
    return {
        name: {
            "design": "uniform",
            "seed": seed,
            "n": n[name],
            "digest": digests[name],
            "file": (files or {}).get(name, ""),
        }
        for name, seed in set_seeds(profile).items()
    }


def simulate_stage(study: Study) -> Outcome:
    """Simulate the nested training design, the validation and the test set."""
    data, space = study.profile.data, study.case.parameter_space
    sizes = {"train": max(data.n_train), "validation": data.n_validation, "test": data.n_test}
    seeds = set_seeds(study.profile)
    inputs = {"case": study.case.digest, "n": sizes, "seeds": seeds, "design": "uniform"}
    total = sum(sizes.values())
    designs = {name: uniform_design(space, n, seeds[name]) for name, n in sizes.items()}

    def work() -> tuple[Summary, list[Path]]:
        sets, done = {}, 0
        with (
            open_physical_model(study) as model,
            study.console.progress("simulations", total) as advance,
        ):
            for name, theta in designs.items():
                sets[name] = _simulated(study, model, name, theta, on_progress=_after(done, total, advance))
                done += len(theta)
            summary = _summary(study, sets) | {"n_reused": model.n_reused}
        say_reused(study, "simulate", model)
        _say_failed(study, summary)
        return summary, [found.rows.file for found in sets.values()]

    if not _is_complete(study, designs):
        (study.results / "simulate.json").unlink(missing_ok=True)
    return run_stage(
        study,
        "simulate",
        what=f"{total} simulations ({', '.join(f'{n} {name}' for name, n in sizes.items())})",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{count(summary['n_simulations'], 'simulation')} reused",
    )


def missing_rows(study: Study) -> tuple[int, int]:
    """Return how many rows of all sets are not stored yet, and how many there are."""
    data, space, seeds = study.profile.data, study.case.parameter_space, set_seeds(study.profile)
    sizes = {"train": max(data.n_train), "validation": data.n_validation, "test": data.n_test}
    designs = [uniform_design(space, n, seeds[name]) for name, n in sizes.items()]
    total = sum(sizes.values())
    try:
        with SimulationStore.at(store_file(study.paths, study.case)) as store:
            return total - sum(int(store.find(theta).sum()) for theta in designs), total
    except InputError:
        return total, total


def show_sets(study: Study, outcome: Outcome) -> None:
    """Print the simulated sets."""
    found, paths = outcome.summary, study.paths
    files = {name: paths.show(paths.root / file) for name, file in found["files"].items()}
    study.console.table(
        f"{study.label}: simulations",
        [Column("set"), Column("rows", True), Column("failed", True), Column("file")],
        [[name, found["n"][name], found["n_failed"][name], file] for name, file in files.items()],
    )
    store = paths.show(paths.root / found["store"])
    study.console.result(f"all simulations: {store} (`studies simulate --help` shows how to read them)")


def set_files(study: Study, summary: Summary) -> dict[str, Path]:
    """Return the files of a finished simulate stage's sets."""
    return {name: study.paths.root / file for name, file in summary["files"].items()}


def sensitivity_stage(study: Study) -> Outcome:
    """Estimate the Sobol indices of the physical model."""
    budget = study.profile.sensitivity
    n_rows = budget.n_base * (study.case.parameter_space.n_parameters + 2)
    inputs = {
        "case": study.case.digest,
        "n_base": budget.n_base,
        "n_resamples": budget.n_resamples,
        "seed": study.profile.seed,
    }
    file = study.results / "sensitivity.npz"
    recipe = recipe_of(study, "sensitivity", command=f"studies sensitivity {study.command}")

    def work() -> tuple[Summary, list[Path]]:
        from studies.stages.tracking import log_sensitivity

        started_s = time.time()
        found, indices = estimate_indices(study, n_rows)
        indices.save(file)
        summary = {**found, "file": study.paths.recorded(file)}
        when = {"started_s": started_s, "wall_s": time.time() - started_s}
        made = environment()
        log_sensitivity(study, summary, digest_of(inputs), file=file, recipe=recipe, made_with=made, **when)
        return summary, [file]

    return run_stage(
        study,
        "sensitivity",
        what=f"Sobol indices from {n_rows} simulations",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{summary['n_calls']} simulations reused",
        recipe=recipe,
    )


def estimate_indices(study: Study, n_rows: int) -> "tuple[Summary, SobolIndices]":
    """Estimate Sobol indices and keep nothing but the simulations.

    Args:
        study: the study.
        n_rows: simulations that the budget comes to.

    Returns:
        Their averages over time, and the indices.
    """
    from studies.sensitivity import sobol_indices

    budget = study.profile.sensitivity
    with (
        open_physical_model(study) as model,
        study.console.progress("simulations", n_rows) as advance,
    ):
        indices = sobol_indices(
            model,
            n_base=budget.n_base,
            seed=study.profile.seed,
            n_resamples=budget.n_resamples,
            on_progress=advance,
        )
    say_reused(study, "sensitivity", model)
    first, total = indices.mean_first_order()[0], indices.mean_total_order()[0]
    order = indices.order()
    summary: Summary = {
        "n_calls": indices.n_calls,
        "n_dropped_blocks": indices.n_dropped,
        "output": indices.output_names[0],
        "mean_first_order": {indices.names[i]: _plain(first[i]) for i in order},
        "mean_total_order": {indices.names[i]: _plain(total[i]) for i in order},
    }
    return summary, indices


def show_sensitivity(study: Study, outcome: Outcome) -> None:
    """Print the indices averaged over time, most influential parameter first."""
    first, total = outcome.summary["mean_first_order"], outcome.summary["mean_total_order"]
    units = {parameter.name: parameter.unit for parameter in study.case.parameter_space.parameters}
    study.console.table(
        f"{study.label}: Sobol indices of {outcome.summary['output']}, averaged over time",
        [Column("parameter"), Column("unit"), Column("first order", True), Column("total order", True)],
        [[name, units[name], _cell(first[name]), _cell(total[name])] for name in first],
    )


def _is_complete(study: Study, designs: dict[str, FloatArray]) -> bool:
    """Say whether all rows of a finished stage are still stored."""
    if not (study.results / "simulate.json").is_file():
        return True
    try:
        with SimulationStore.at(store_file(study.paths, study.case)) as store:
            return all(bool(store.find(theta).all()) for theta in designs.values())
    except InputError:
        return False


def _simulated(
    study: Study, model: StoredModel, name: str, theta: FloatArray, *, on_progress: OnProgress
) -> SimulatedSet:
    """Simulate what is not stored of a set; a longer design of the same seed begins with the same rows."""
    identity = digest_of({"case": study.case.digest, "set": name, "theta": theta.tobytes().hex()})
    file = study.paths.generated(study.case.name) / "sets" / f"{name}-n{len(theta):05d}-{identity[:12]}.npz"
    model.complete(theta, on_progress=lambda n_done: on_progress(n_done, len(theta)))
    rows = RowSet(theta, model.store.file, file)
    rows.save()
    return SimulatedSet(rows, content_of(model.store.stream(theta)))


def _summary(study: Study, sets: dict[str, SimulatedSet]) -> Summary:
    reasons = {reason for found in sets.values() for reason in found.content.failures if reason}
    return {
        "n": {name: found.rows.n for name, found in sets.items()},
        "n_simulations": sum(found.rows.n for found in sets.values()),
        "n_failed": {name: found.n_failed() for name, found in sets.items()},
        "n_failed_of_training_size": {str(n): sets["train"].n_failed(n) for n in study.profile.data.n_train},
        "first_failures": sorted(reasons)[:3],
        "files": {name: study.paths.relative(found.rows.file) for name, found in sets.items()},
        "digests": {name: found.content.digest for name, found in sets.items()},
        "store": study.paths.relative(store_file(study.paths, study.case)),
    }


def _say_failed(study: Study, summary: Summary) -> None:
    n_failed = sum(summary["n_failed"].values())
    if n_failed:
        study.console.warn(
            f"{count(n_failed, 'simulation')} failed, left out: {'; '.join(summary['first_failures'])} "
            "(--retry-failed asks them again)"
        )


def _after(done: int, total: int, advance: OnProgress) -> OnProgress:
    return lambda part, _: advance(done + part, total)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _cell(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"
