"""What a trial costs beside its training: claim, record, Optuna and MLflow, with files and with PostgreSQL.

A trial of 200 epochs with 4 curves. Beside it a naive logger: Optuna's report and MLflow's log_metric at
every epoch. What the worker pays delays its next trial; the command's own process does the rest meanwhile.

    python tests/benchmarks/trial_overhead.py
"""

import json
import logging
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from postgres_for_tests import PostgresServer, missing_postgres

from simulation.toy import ToyRC
from studies.paths import ProjectPaths
from studies.search_ranges import NETWORK_RANGES
from studies.tracking.origin import environment
from studies.tracking.tracker import open_tracker
from studies.tuning.claim import this_owner
from studies.tuning.slots import Slot, take_slot
from studies.tuning.study_spec import StudySpec
from studies.tuning.study_store import StudyStore, open_optuna
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_store import open_trials

N_TRIALS, N_EPOCHS = 30, 200
CURVES = ("loss", "reconstruction", "divergence", "validation_mae")


def a_spec() -> StudySpec:
    """Return a study whose hyperparameters cost no search."""
    return StudySpec(
        label="overhead",
        n_train=64,
        case_name="toy",
        case_digest="c" * 64,
        fmu_sha256="f" * 64,
        parameter_space=ToyRC().parameter_space,
        output_names=("T",),
        output_unit="K",
        output_scales=(1.0,),
        train_file=Path("train.npz"),
        validation_file=Path("validation.npz"),
        test_file=Path("test.npz"),
        train_digest="1" * 64,
        validation_digest="2" * 64,
        test_digest="3" * 64,
        variant="refined",
        search=NETWORK_RANGES,
        enqueue=tuple({"beta": 2.0 + index} for index in range(N_TRIALS)),
    )


def a_record(spec: StudySpec, slot: Slot, origin: dict[str, str]) -> TrialRecord:
    """Return what a training would have come to."""
    claim = slot.claim
    errors = dict.fromkeys(("val/mae", "val/p90", "test/mae", "test/p90"), 0.1 + 0.001 * claim.index)
    return TrialRecord(
        study=spec.name,
        n_train=spec.n_train,
        index=claim.index,
        state="complete",
        reason="",
        params=claim.params,
        config=claim.config,
        seed=claim.seed,
        started_s=claim.started_s,
        wall_s=1.0,
        digests=spec.digests,
        owner=claim.owner,
        origin=claim.origin,
        environment=origin,
        metrics=errors,
        reports={str(epoch): 1.0 / epoch for epoch in range(5, N_EPOCHS + 1, 13)},
        n_epochs=N_EPOCHS,
        best_epoch=N_EPOCHS,
        n_rows=64,
    )


def ours(paths: ProjectPaths) -> dict[str, float]:
    """Return the median cost of a trial to its worker and to the command's process. [ms]."""
    spec, origin = a_spec(), environment()
    store, view, tracker = open_trials(paths, spec), StudyStore(spec, paths), open_tracker(paths)
    tracker.start_study(spec, n_trials=N_TRIALS)
    weights = paths.root / "weights"
    weights.mkdir()
    generator = np.random.default_rng(0)
    (weights / "weights.npz").write_bytes(generator.bytes(400_000))
    (weights / "surrogate.json").write_text("{}")
    history = {"epoch": np.arange(1, N_EPOCHS + 1), **{name: generator.random(N_EPOCHS) for name in CURVES}}
    costs: dict[str, list[float]] = {"claim": [], "record": [], "optuna": [], "mlflow": []}
    owner = this_owner()

    def timed(name: str, work: Callable[[], Any]) -> Any:
        tick = time.perf_counter()
        result = work()
        costs[name].append(1000.0 * (time.perf_counter() - tick))
        return result

    def keep(record: TrialRecord) -> None:
        store.write(record, history, weights)
        store.keep_only_best()

    for _ in range(N_TRIALS):
        slot = timed("claim", lambda: take_slot(spec, store, n_trials=N_TRIALS, owner=owner))
        record = a_record(spec, slot, origin)
        timed("record", lambda record=record: keep(record))
        timed("optuna", lambda: view.tell(store))
        timed(
            "mlflow",
            lambda record=record: tracker.log_trial(spec, record, lambda: store.history(record.index)),
        )
    view.close()
    medians = {name: float(np.median(found)) for name, found in costs.items()}
    medians["worker"] = medians["claim"] + medians["record"]
    medians["all"] = medians["worker"] + medians["optuna"] + medians["mlflow"]
    return medians


def naive(paths: ProjectPaths) -> float:
    """Return what one trial costs whose every epoch is told singly. [ms]."""
    from studies.tracking.quiet_mlflow import connect

    client = connect(paths.tracking_uri)
    experiment = client.create_experiment("naive", (paths.root / "artifacts").as_uri())
    study = optuna.create_study(storage=open_optuna(paths), study_name="naive")
    tick = time.perf_counter()
    trial = study.ask()
    trial.suggest_float("beta", 1.0, 10.0)
    run = client.create_run(experiment)
    for epoch in range(N_EPOCHS):
        trial.report(1.0 / (epoch + 1), epoch)
        for name in CURVES:
            client.log_metric(run.info.run_id, name, 1.0 / (epoch + 1), step=epoch)
    study.tell(trial, 0.1)
    client.set_terminated(run.info.run_id)
    return 1000.0 * (time.perf_counter() - tick)


def main() -> None:
    """Measure both storages and print medians and ratios."""
    logging.disable(logging.WARNING)
    found = {}
    server = None if missing_postgres() else PostgresServer()
    try:
        for name in ("files", "postgres"):
            if name == "postgres" and server is None:
                print(f"postgres: {missing_postgres()}")
                continue
            with tempfile.TemporaryDirectory() as folder:
                url = server.new_database() if server and name == "postgres" else None
                paths = ProjectPaths(Path(folder), url)
                costs = ours(paths)
                simple = naive(paths)
            costs["naive logger"] = simple
            found[name] = {key: round(value, 1) for key, value in costs.items()}
            print(f"{name}: {found[name]}; the naive logger costs {simple / costs['all']:.0f} times as much")
    finally:
        if server is not None:
            server.close()
    print(json.dumps(found))


if __name__ == "__main__":
    main()
