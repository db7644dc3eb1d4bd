"""Trials of the office trained to their end and kept in a file, to replay samplers and pruners over.

Run `python tests/benchmarks/trained_trials.py FILE [--sizes 64 128] [--seeds 0 1 2 3 4] [--trials 20]
[--random 60]`; it adds to FILE (JSON lines) what is not there yet. Training follows the `quick` profile: the
refined variant, 400 epochs, one thread. Each seed is a study without pruning; the random trials are draws
from the whole search space.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from simulation.case import load_case  # noqa: E402
from simulation.design import uniform_design  # noqa: E402
from simulation.store.row_set import RowSet  # noqa: E402
from simulation.store.store import SimulationStore  # noqa: E402
from studies.profile import load_profile  # noqa: E402
from studies.stages.simulate import TEST_SEED, VALIDATION_SEED, train_seed  # noqa: E402
from studies.tuning.search_space import Proposal, propose  # noqa: E402
from studies.tuning.study_data import StudyData, load_data  # noqa: E402
from studies.tuning.study_spec import StudySpec, TrialState  # noqa: E402
from studies.tuning.trial_record import TrialRecord  # noqa: E402
from studies.tuning.trial_training import TrialOutcome, train_trial  # noqa: E402

RANDOM = -1  # seed of trials that belong to no study


@dataclass(frozen=True)
class Trained:
    """A trial that was trained to its end.

    Attributes:
        n_train: Training-set size.
        seed: Of its study; RANDOM for a draw from the whole space.
        index: Its place there.
        params: Hyperparameters in search coordinates.
        epochs: Validated epochs.
        curve: Validation MAE there; shorter than `epochs` asks where the training diverged. [K]
        metrics: Errors of the trained surrogate; empty where the training diverged. [K]
        cpu_s: Processor time of the training. [s]
    """

    n_train: int
    seed: int
    index: int
    params: dict[str, float | int]
    epochs: list[int]
    curve: list[float]
    metrics: dict[str, float]
    cpu_s: float


def read(file: Path) -> list[Trained]:
    """Return the trials in a file."""
    if not file.is_file():
        return []
    return [Trained(**json.loads(line)) for line in file.read_text().splitlines()]


def office_spec(folder: Path, n_train: int, seed: int = 0) -> StudySpec:
    """Simulate the office's sets into a folder and declare a study of the `quick` profile on them."""
    case, profile = load_case(ROOT / "fmus" / "office"), load_profile("quick")
    seeds = {"train": train_seed(0), "validation": VALIDATION_SEED, "test": TEST_SEED}
    files = {name: folder / f"{name}.npz" for name in seeds}
    if not files["test"].is_file():
        with case.open_model() as model:
            for name, one in seeds.items():
                n = {"train": 512}.get(name, 320)
                rows = model.simulate(uniform_design(case.parameter_space, n, one))
                with SimulationStore(
                    folder / "simulations",
                    model_digest=case.model_digest,
                    parameter_names=rows.parameter_names,
                    output_names=rows.output_names,
                    time=rows.time,
                ) as store:
                    store.append(rows)
                    RowSet(rows.theta, store.folder, files[name]).save()
    return StudySpec.from_files(
        train_file=files["train"],
        validation_file=files["validation"],
        test_file=files["test"],
        n_train=n_train,
        parameter_space=case.parameter_space,
        label="office-quick",
        case_name=case.name,
        case_digest=case.digest,
        fmu_sha256=case.fmu_sha256,
        output_unit=case.outputs[0].unit,
        output_scales=tuple(case.measurement.error_scales.tolist()),
        variant=profile.tuning.variant,
        overrides={"max_epochs": profile.tuning.max_epochs, "device": "cpu", "n_threads": 1},
        search=profile.tuning.search,
        seed=seed,
    )


def train(
    spec: StudySpec,
    proposal: Proposal,
    data: StudyData,
    index: int,
    is_hopeless: Callable[[int, float], bool] = lambda epoch, value: False,
) -> tuple[Trained, TrialOutcome]:
    """Train what was proposed, to its end where nothing stops it."""
    outcome, began = TrialOutcome(), time.process_time()
    try:
        train_trial(
            spec,
            proposal.config,
            proposal.seed,
            data,
            outcome=outcome,
            on_epoch=lambda report: None,
            is_hopeless=is_hopeless,
        )
    except Exception as error:  # a diverged training is a result here too
        print(f"n_train {spec.n_train} trial {index}: {error}", file=sys.stderr)
    trained = Trained(
        spec.n_train,
        spec.seed,
        index,
        proposal.params,
        epochs=[int(epoch) for epoch in outcome.history["epoch"]],
        curve=outcome.history["validation_mae"],
        metrics=outcome.metrics,
        cpu_s=time.process_time() - began,
    )
    return trained, outcome


def as_record(
    spec: StudySpec, trained: Trained, proposal: Proposal, *, state: TrialState = "complete"
) -> TrialRecord:
    """Return the record of a trial; one that has no errors has failed."""
    return TrialRecord(
        study=spec.name,
        n_train=spec.n_train,
        index=trained.index,
        state=state if trained.metrics else "failed",
        reason="",
        params=proposal.params,
        config=proposal.config.to_dict(),
        seed=proposal.seed,
        started_s=0.0,
        wall_s=trained.cpu_s,
        digests={},
        owner={},
        metrics=trained.metrics,
        n_epochs=max(trained.epochs, default=0),
    )


def _study(spec: StudySpec, known: list[Trained], n_trials: int) -> Iterator[Trained]:
    """Continue a study without pruning to a number of trials."""
    data = load_data(spec)
    records: list[TrialRecord] = []
    for index in range(n_trials):
        proposal = propose(spec, index, records)
        if index < len(known):
            trained = known[index]
        else:
            trained, _ = train(spec, proposal, data, index)
            yield trained
        records.append(as_record(spec, trained, proposal))


def _random(spec: StudySpec, known: list[Trained], n_trials: int) -> Iterator[Trained]:
    """Continue the draws from the whole space to a number of trials."""
    data = load_data(spec)
    for index in range(len(known), n_trials):
        drawn = propose(replace(spec, seed=10_000 + index), 1, [])
        yield train(spec, drawn, data, index)[0]


def main() -> None:
    """Train what is missing."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--random", type=int, default=60)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for n_train in chosen.sizes:
            for seed in [*chosen.seeds, RANDOM]:
                known = [one for one in read(chosen.file) if (one.n_train, one.seed) == (n_train, seed)]
                spec = replace(office_spec(Path(folder), n_train), seed=seed)
                made = (
                    _random(spec, known, chosen.random)
                    if seed == RANDOM
                    else _study(spec, known, chosen.trials)
                )
                for trained in made:
                    with chosen.file.open("a") as stream:
                        stream.write(json.dumps(asdict(trained)) + "\n")
                print(f"n_train {n_train}, seed {seed}: done", flush=True)


if __name__ == "__main__":
    main()
