"""Stages that ask the physical model for data: the simulated sets and the Sobol indices."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.design import uniform_design
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.generate import generate
from simulation.parallel import ParallelModel
from simulation.trajectories import Trajectories
from studies.console import Column, OnProgress
from studies.pipeline import Outcome, Study, Summary, digest_of, run_stage

VALIDATION_SEED, TEST_SEED = 320_001, 320_002
"""Validation and test sets are the same for every profile and seed, so that all errors can be compared."""
TRAIN_SEED_BASE = 1_000
CHUNK_SIZE = 64


@dataclass(frozen=True)
class SetFile:
    """A simulated set on disk.

    Args:
        name: train, validation or test.
        file: its trajectories.
        n: rows, failed ones included.
        n_failed: rows without a result.
        n_reused: rows that were simulated before.
    """

    name: str
    file: Path
    n: int
    n_failed: int
    n_reused: int


class StoredModel(WrappedModel):
    """A model whose answers are kept in a folder: a batch asked again is read, an interrupted one completed.

    Args:
        model: the model to ask.
        folder: where its answers lie.
        model_digest: digest of the model.
    """

    def __init__(self, model: ForwardModel, folder: Path, *, model_digest: str) -> None:
        super().__init__(model)
        self._folder = folder
        self._model_digest = model_digest

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Read the rows that are known and simulate the others.

        Args:
            theta: parameters. Shape (n, p). [per parameter]
        """
        rows = np.ascontiguousarray(theta, dtype="<f8")
        folder = self._folder / digest_of({"rows": rows.tobytes().hex()})[:12]
        return generate(
            self._model, theta, folder, chunk_size=CHUNK_SIZE, model_digest=self._model_digest
        ).trajectories


def train_seed(seed: int) -> int:
    """Return the seed of the training design, never that of a set that judges.

    Args:
        seed: the study's seed.
    """
    own = TRAIN_SEED_BASE + seed
    return own if own < VALIDATION_SEED else own + 2


def simulate_stage(study: Study) -> Outcome:
    """Simulate the nested training design, the validation and the test set."""
    data, space = study.profile.data, study.case.parameter_space
    sizes = {"train": max(data.n_train), "validation": data.n_validation, "test": data.n_test}
    seeds = {
        "train": train_seed(study.profile.seed),
        "validation": VALIDATION_SEED,
        "test": TEST_SEED,
    }
    inputs = {"case": study.case.digest, "n": sizes, "seeds": seeds, "design": "uniform"}
    total = sum(sizes.values())

    def work() -> tuple[Summary, list[Path]]:
        sets = []
        with (
            ParallelModel(study.case.make_model, study.n_jobs) as model,
            study.console.progress("simulations", total) as advance,
        ):
            done = 0
            for name, n in sizes.items():
                theta = uniform_design(space, n, seeds[name])
                sets.append(
                    _generate_set(study, model, name, theta, on_progress=_after(done, total, advance))
                )
                done += n
        summary = _summary(study, sets)
        _say_sets(study, summary)
        return summary, [found.file for found in sets]

    return run_stage(
        study,
        "simulate",
        what=f"{total} simulations ({', '.join(f'{n} {name}' for name, n in sizes.items())})",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{summary['n_simulations']} simulations reused",
    )


def show_sets(study: Study, outcome: Outcome) -> None:
    """Print the simulated sets."""
    found = outcome.summary
    study.console.table(
        f"{study.label}: simulations",
        [Column("set"), Column("rows", True), Column("failed", True), Column("file")],
        [[name, found["n"][name], found["n_failed"][name], found["files"][name]] for name in found["files"]],
    )


def set_files(study: Study, summary: Summary) -> dict[str, Path]:
    """Return the trajectory files of a finished simulate stage by set."""
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

    def work() -> tuple[Summary, list[Path]]:
        from studies.sensitivity import sobol_indices
        from studies.stages_tracking import log_sensitivity

        started = time.perf_counter()
        folder = study.paths.generated(study.case.name) / f"sobol-{study.case.digest[:12]}"
        with (
            ParallelModel(study.case.make_model, study.n_jobs) as model,
            study.console.progress("simulations", n_rows) as advance,
        ):
            indices = sobol_indices(
                StoredModel(model, folder, model_digest=study.case.digest),
                n_base=budget.n_base,
                seed=study.profile.seed,
                n_resamples=budget.n_resamples,
                on_progress=advance,
            )
        indices.save(file)
        first, total = indices.mean_first_order()[0], indices.mean_total_order()[0]
        order = indices.order()
        summary: Summary = {
            "n_calls": indices.n_calls,
            "n_dropped_blocks": indices.n_dropped,
            "output": indices.output_names[0],
            "mean_first_order": {indices.names[i]: _plain(first[i]) for i in order},
            "mean_total_order": {indices.names[i]: _plain(total[i]) for i in order},
            "file": study.paths.show(file),
        }
        log_sensitivity(study, summary, digest_of(inputs), file=file, wall_s=time.perf_counter() - started)
        return summary, [file]

    return run_stage(
        study,
        "sensitivity",
        what=f"Sobol indices from {n_rows} simulations",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{summary['n_calls']} simulations reused",
    )


def show_sensitivity(study: Study, outcome: Outcome) -> None:
    """Print the indices averaged over time, most influential parameter first."""
    first, total = outcome.summary["mean_first_order"], outcome.summary["mean_total_order"]
    units = {parameter.name: parameter.unit for parameter in study.case.parameter_space.parameters}
    study.console.table(
        f"{study.label}: Sobol indices of {outcome.summary['output']}, averaged over time",
        [Column("parameter"), Column("unit"), Column("first order", True), Column("total order", True)],
        [[name, units[name], _cell(first[name]), _cell(total[name])] for name in first],
    )


def _generate_set(
    study: Study, model: ForwardModel, name: str, theta: FloatArray, *, on_progress: OnProgress
) -> SetFile:
    """Simulate one set; a longer design of the same seed goes on in the same folder."""
    identity = digest_of({"case": study.case.digest, "set": name, "first_row": theta[0].tolist()})
    folder = study.paths.generated(study.case.name) / f"{name}-{identity[:12]}"
    result = generate(
        model, theta, folder, chunk_size=CHUNK_SIZE, model_digest=study.case.digest, on_progress=on_progress
    )
    file = folder / f"rows-{len(theta):05d}.npz"
    result.trajectories.save(file)
    failed = int(result.trajectories.failed.sum())
    return SetFile(name, file, len(theta), failed, result.n_reused)


def _summary(study: Study, sets: list[SetFile]) -> Summary:
    train = Trajectories.load(sets[0].file)
    return {
        "n": {found.name: found.n for found in sets},
        "n_simulations": sum(found.n for found in sets),
        "n_reused": sum(found.n_reused for found in sets),
        "n_failed": {found.name: found.n_failed for found in sets},
        "n_failed_of_training_size": {
            str(n): int(train.failed[:n].sum()) for n in study.profile.data.n_train
        },
        "first_failures": sorted({reason for reason in train.failures if reason})[:3],
        "files": {found.name: study.paths.relative(found.file) for found in sets},
    }


def _say_sets(study: Study, summary: Summary) -> None:
    if summary["n_reused"]:
        study.console.say(f"simulate: {summary['n_reused']} of {summary['n_simulations']} simulations reused")
    n_failed = sum(summary["n_failed"].values())
    if n_failed:
        reasons = "; ".join(summary["first_failures"]) or "see the trajectory files"
        study.console.warn(f"{n_failed} simulations failed and are left out: {reasons}")


def _after(done: int, total: int, advance: OnProgress) -> OnProgress:
    return lambda part, _: advance(done + part, total)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _cell(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"
