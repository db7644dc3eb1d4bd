"""A small study of a two-parameter RC network, and what its trials came to, as Optuna and MLflow have it."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import psutil
from optuna.trial import FrozenTrial
from toy_rc import ToyRC

from pelsvae.config import VARIANTS
from simulation.design import uniform_design
from simulation.store.store import SimulationStore
from simulation.trajectories import Trajectories
from studies.paths import ProjectPaths
from studies.results.declaration import SETS, Declaration
from studies.results.row_set import RowSet
from studies.tracking.quiet_mlflow import connect, entities
from studies.tuning.attempts import places

N_TUNED = 8
"""Trials of the studies that are tuned once for all tests."""

ROOT = Path(__file__).resolve().parents[2]
LABEL = "toy-small"
SIZES = {"train": 32, "validation": 24, "test": 24}
FILES = {name: f"data/toy/{name}.npz" for name in SETS}
SEARCH: dict[str, dict[str, Any]] = {
    "n_latent": {"kind": "int", "low": 2, "high": 8, "log": True},
    "n_hidden": {"kind": "int", "low": 8, "high": 32, "log": True},
    "beta": {"kind": "float", "low": 1.0, "high": 1000.0, "log": True},
}
BRIEF = {"max_epochs": 12, "validate_every": 1, "patience": 12}


def add_sets(root: Path) -> None:
    """Simulate the three sets of the toy into a project."""
    model = ToyRC()
    (root / "data" / "toy").mkdir(parents=True, exist_ok=True)
    for seed, (name, n) in enumerate(SIZES.items()):
        store_set(model.simulate(uniform_design(model.parameter_space, n, seed)), root / FILES[name])


def store_set(rows: Trajectories, file: Path) -> None:
    """Store rows beside a file, and write the set to it."""
    with SimulationStore(
        file.parent / "simulations.db",
        model_digest="toy",
        parameter_names=rows.parameter_names,
        output_names=rows.output_names,
        time=rows.time,
    ) as store:
        store.append(rows.take(~store.find(rows.theta)))
        RowSet(rows.theta, store.file, file).save()


@cache
def set_digests(n_train: int) -> dict[str, str]:
    """Return the digests of the sets, as the simulate stage finds them."""
    model = ToyRC()
    rows = {
        name: model.simulate(uniform_design(model.parameter_space, n, seed))
        for seed, (name, n) in enumerate(SIZES.items())
    }
    rows["train"] = rows["train"].take(np.arange(n_train))
    return {name: one.digest for name, one in rows.items()}


def toy_study(n_train: int = 16, **changes: Any) -> Declaration:
    """Declare a study of the toy; anything of it may be changed by name."""
    space = ToyRC().parameter_space
    spec = Declaration(
        label=LABEL,
        n_train=n_train,
        case_name="toy",
        surrogate="refined",
        settings=_settings(**BRIEF),
        search=SEARCH,
        sampler={"name": "TPESampler", "n_startup_trials": 3},
        pruner={"name": "NopPruner"},
        seed=5,
        parameter_names=space.names,
        lower=tuple(space.lower.tolist()),
        upper=tuple(space.upper.tolist()),
        is_log=tuple(space.is_log.tolist()),
        output_names=("T",),
        output_unit="K",
        output_scales=(1.0,),
        files=FILES,
        digests={"case": "c" * 64, "fmu": "f" * 64, **set_digests(n_train)},
        device="cpu",
        note="A toy.",
    )
    return replace(spec, **changes)


def tuned_study(n_train: int) -> Declaration:
    """Declare a study of the project `tuned`: some trials are pruned, the rest completes."""
    pruner = {"name": "MedianPruner", "n_startup_trials": 2, "n_warmup_steps": 3}
    return toy_study(n_train, pruner=pruner)


def baseline(n_train: int = 16) -> Declaration:
    """Declare the PCA + GP beside a study."""
    longer = {"max_epochs": 5, "patience": 5, "n_members": 2}
    return toy_study(
        n_train,
        surrogate="pca-gp",
        settings=_settings("pca-gp", **longer),
        search={},
        sampler={"name": "RandomSampler"},
        is_baseline=True,
    )


def _settings(variant: str = "refined", **changes: Any) -> dict[str, Any]:
    """Return a surrogate's settings as a declaration has them."""
    found = VARIANTS[variant].replace(**changes).to_dict()
    return {name: value for name, value in found.items() if name not in ("device", "n_threads")}


SPECS = [tuned_study(16), baseline(16), tuned_study(24), baseline(24)]
"""The studies of the project `tuned`."""


def plain_study(paths: ProjectPaths, name: str) -> optuna.Study:
    """Load a study as its user would: Optuna and the URL, nothing of ours."""
    return optuna.load_study(study_name=name, storage=paths.optuna_url)


def states(trials: list[FrozenTrial]) -> list[str]:
    """Return the states of trials."""
    return [trial.state.name for trial in trials]


def essence(study: optuna.Study) -> list[tuple[Any, ...]]:
    """Return what must be the same however often a study was disturbed: a row per place, in order."""
    return [
        (
            trial.state.name,
            json.dumps(trial.params, sort_keys=True),
            trial.value,
            trial.user_attrs.get("test/mae"),
            trial.user_attrs.get("seed"),
            trial.user_attrs.get("proposed_by"),
            trial.intermediate_values,
        )
        for trial in places(study.get_trials())
    ]


def runs_of(paths: ProjectPaths, label: str, **tags: str) -> list[entities.Run]:
    """Return the runs of a label that have some tags, the earliest first."""
    client = connect(paths.tracking_uri)
    experiment = client.get_experiment_by_name(label)
    if experiment is None:
        return []
    wanted = " and ".join(f"tags.`{name}` = '{value}'" for name, value in tags.items())
    ids = [experiment.experiment_id]
    return list(client.search_runs(ids, wanted, order_by=["attributes.start_time ASC"], max_results=5000))


def workers_of(process: int) -> list[psutil.Process]:
    """Return the workers that a process has started and that live."""
    found = []
    for one in psutil.Process(process).children(recursive=True):
        with suppress(psutil.Error):  # it has just ended
            if "multiprocessing.forkserver" in " ".join(one.cmdline()):
                found += one.children()
    return found


STATUS = {"COMPLETE": "FINISHED", "PRUNED": "FINISHED", "FAIL": "FAILED"}


def assert_mlflow_agrees(paths: ProjectPaths, label: str = LABEL, *names: str) -> None:
    """Check that each place of the studies has one run, which says what Optuna says, and no run is open."""
    runs = runs_of(paths, label)
    assert not [run.info.run_name for run in runs if run.info.status == "RUNNING"]
    by_id: Mapping[str, entities.Run] = {run.info.run_id: run for run in runs}
    reported = set()
    for name in names:
        for trial in places(plain_study(paths, name).get_trials()):
            run = by_id[trial.user_attrs["mlflow_run_id"]]
            assert run.info.run_id not in reported
            reported.add(run.info.run_id)
            assert run.info.status == STATUS[trial.state.name]
            assert run.data.tags["trial"] == str(trial.number)
            assert run.data.tags["trial_state"] == trial.state.name.lower()
            assert run.data.tags["pruned"] == str(trial.state.name == "PRUNED")
            assert run.data.metrics.get("val/mae") == trial.value or trial.state.name == "PRUNED"
            assert all(run.data.params[key] == str(value) for key, value in trial.params.items())
        trial_runs = [run for run in runs if run.data.tags.get("role") == "trial"]
        others = [
            run for run in trial_runs if run.data.tags["study"] == name and run.info.run_id not in reported
        ]
        assert {run.info.status for run in others} <= {"KILLED", "FAILED"}, [r.data.tags for r in others]
