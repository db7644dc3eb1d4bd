"""What a trial of 200 epochs with 4 curves costs beside its training: Optuna, MLflow and the weights.

Two workers on two studies side by side, as `studies tune` runs them, on SQLite and on PostgreSQL. The cost of
a trial is the time from its begin to that of the next one, less the time that its training takes alone,
without anybody who listens, in this process. Prints and gates nothing; the goal is 0.3 s. Type:

    python tests/benchmarks/trial_overhead.py
"""

import statistics
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS), str(TESTS / "tuning")]
N_TRIALS, N_EPOCHS, GOAL_S = 15, 200, 0.3
SIZES = (16, 24)


def main() -> None:
    """Measure both storages and print medians."""
    from mlflow_store_for_tests import give_store
    from postgres_for_tests import PostgresServer, missing_postgres
    from toy_study_for_tests import add_sets, toy_study

    from studies.paths import ProjectPaths
    from studies.tuning.declaration import Declaration

    def spec(n_train: int) -> Declaration:
        settings = toy_study().settings | {"max_epochs": N_EPOCHS, "patience": N_EPOCHS}
        # One configuration again and again, so that each trial trains for the same time.
        return toy_study(n_train, settings=settings, search={})

    server = None if missing_postgres() else PostgresServer()
    try:
        for name in ("SQLite", "PostgreSQL"):
            if name == "PostgreSQL" and server is None:
                print(f"PostgreSQL: {missing_postgres()}")
                continue
            with tempfile.TemporaryDirectory() as folder:
                root = Path(folder)
                add_sets(root)
                give_store(root)
                url = server.new_database() if server and name == "PostgreSQL" else None
                _measure(name, [spec(n) for n in SIZES], ProjectPaths(root, url))
    finally:
        if server is not None:
            server.close()


def _measure(name: str, specs: list, paths) -> None:  # type: ignore[no-untyped-def, type-arg]
    from threadpoolctl import threadpool_limits
    from toy_study_for_tests import plain_study

    from studies.tuning.training import load_data, train
    from studies.tuning.tune import tune

    tune(specs, paths=paths, n_trials=N_TRIALS, n_jobs=len(specs))
    for spec in specs:
        data, alone = load_data(spec, paths), []
        with threadpool_limits(1):
            for place in range(5):
                began = time.perf_counter()
                seed = spec.trial_seed(place, 1)
                train(spec, spec.base_config, seed, data, on_epoch=lambda _: None, on_report=lambda *_: None)
                alone.append(time.perf_counter() - began)
        trials = plain_study(paths, spec.name).get_trials()
        begins = [trial.datetime_start.timestamp() for trial in trials if trial.datetime_start]
        # The first trials of a process load what the later ones have.
        whole = [later - earlier for earlier, later in pairwise(begins[2:])]
        cost, spread = statistics.median(whole) - statistics.median(alone), max(whole) - min(whole)
        print(
            f"{name}, n_train {spec.n_train}: a trial takes {statistics.median(whole):.2f} s (spread "
            f"{spread:.2f} s), its training alone {statistics.median(alone):.2f} s: {cost:.2f} s of "
            f"bookkeeping (goal {GOAL_S:g} s)"
        )


if __name__ == "__main__":
    main()
