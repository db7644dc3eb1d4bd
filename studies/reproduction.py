"""Make a trial or a stage again from what its MLflow run holds, and compare every number.

The run says what was done: the case file's text, the SHA-256 of every file, settings and seed. What it says
is compared with the project, never written into it: the case and its files must be here as they were.
"""

import re
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from simulation.case import load_case
from simulation.errors import InputError
from simulation.foreign_text import quoted, shortened
from studies.comparison import Compared, compare
from studies.console import Column, Console
from studies.paths import ProjectPaths
from studies.provenance import FollowedRecipe, Provenance, provenance_of
from studies.recipe import file_digest
from studies.stages.pipeline import Study, read_json
from studies.stages.results import read_arrays
from studies.tracking.origin import environment
from studies.tracking.runs import CURVE, RunStore
from studies.tracking.stage_run import run_store

if TYPE_CHECKING:
    from mlflow.entities import Run

Result = tuple[Mapping[str, Any], Mapping[str, NDArray[Any]]]
LOOSE = ("wall", "recipe", "environment", "n_reused")
"""Numbers and records of a stage that are others each time."""


class _LastEpochError(Exception):
    """A pruned trial was trained as far as it was then."""


def reproduce(paths: ProjectPaths, name: str, console: Console, *, n_jobs: int) -> tuple[str, list[Compared]]:
    """Make the result of a run again.

    Args:
        paths: the project.
        name: id of an MLflow run, or a calibration as `studies status` names it.
        console: says what is done.
        n_jobs: processes for simulations.

    Returns:
        The run's id and its numbers, recorded and now.

    Raises:
        InputError: there is no such run, it holds nothing that makes it again, or what it was made from is
            not here as it was.
    """
    runs = run_store(paths)
    run = _find(runs, name)
    run_id = str(run.info.run_id)
    with tempfile.TemporaryDirectory(prefix="studies-reproduce-") as scratch:
        record = read_json(runs.fetch(run_id, "provenance.json", Path(scratch))) or {}
        made = provenance_of(record, f"MLflow's run {run_id}")
        recipe = made.recipe
        study = _study(paths, recipe, console, n_jobs)
        _say_differences(console, made.environment)
        what = f"{run.info.run_name} of {study.label} once more"
        with console.stage("reproduce", what), threadpool_limits(made.n_threads):
            if made.declaration is not None:
                (numbers, arrays), (numbers_now, arrays_now) = _trial(run, runs, study, made)
            else:
                numbers, arrays = _recorded(run, runs, Path(scratch))
                # In a folder of its own, so that stored rows are simulated again as well.
                apart = replace(study, paths=ProjectPaths(Path(scratch) / "project"))
                again = _calibration if recipe.settings is None else _adaptive
                numbers_now, arrays_now = again(apart, recipe, (numbers, arrays), runs)
    # A stage notes more of its circumstances than what it calculates.
    kept = {k: v for k, v in numbers.items() if k in numbers_now and not k.startswith(LOOSE)}
    return run_id, compare(kept, numbers_now) + compare(arrays, arrays_now)


def show_reproduction(console: Console, run_id: str, rows: list[Compared]) -> None:
    """Print the numbers side by side and the verdict."""
    columns = [Column("number"), Column("recorded", True), Column("now", True), Column("relative", True)]
    cells = [
        [
            row.name,
            shortened(row.recorded, 40),
            shortened(row.now, 40),
            "" if row.is_equal or row.relative is None else f"{row.relative:.1e}",
            "equal" if row.is_equal else "DIFFERS",
        ]
        for row in rows
    ]
    console.table(f"MLflow's run {run_id}: recorded and made again", [*columns, Column("")], cells)
    n_other = sum(not row.is_equal for row in rows)
    equal = f"equal: all {len(rows)} rows to the last digit"
    console.result(f"differs: {n_other} of {len(rows)} rows" if n_other else equal)


def _find(runs: RunStore, name: str) -> "Run":
    """Find a run by its id, or the latest one of a calibration's name."""
    from mlflow.exceptions import MlflowException

    with suppress(MlflowException):
        if re.fullmatch(r"[0-9a-f]{32}", name):
            return runs.client.get_run(name)
        label, _, stage = name.partition("/")
        found = runs.client.get_experiment_by_name(label)
        for run in reversed(runs.find(label, {"role": "calibration"}) if found else []):
            if stage == run.info.run_name.removesuffix(" calibration"):
                return run
    known = "an MLflow run's id (`studies best --json` has some) or a calibration as in `studies status`"
    raise InputError(f"nothing is called {name!r}; give {known}")


def _study(paths: ProjectPaths, recipe: FollowedRecipe, console: Console, n_jobs: int) -> Study:
    """Put a recipe's study together from the case that is here.

    Raises:
        InputError: the case or one of its files is not as it was.
    """
    recorded = recipe.case
    file = paths.located(recorded.place)
    if file is None:
        raise InputError(f"this run's case file {quoted(recorded.place)} is not in the project; put it there")
    case = load_case(file, window_d=recipe.window_d)
    checks = (
        (recorded.sha256, file_digest(file), "the file itself"),
        (recorded.digest, case.digest, "its FMU or its inputs"),
        (recorded.measurement_digest, case.measurement.digest, "its measurement"),
    )
    for was, now, what in checks:
        if was != now:
            before = shortened(was[:12])
            raise InputError(f"{paths.show(file)}: {what} changed since this was made; restore it ({before})")
    return Study(
        case=case,
        profile=recipe.profile,
        paths=paths,
        console=console,
        n_jobs=n_jobs,
        label=recipe.label,
        command=recipe.command,
    )


def _say_differences(console: Console, was: Mapping[str, str]) -> None:
    """Say which packages, code and machine differ from the recorded ones."""
    now = environment()
    for key in sorted(set(was) | set(now)):
        if was.get(key) != now.get(key) and key != "device":
            before, after = (shortened(one.get(key, "–"), 40) for one in (was, now))
            console.say(f"  {key}: {before} -> {after}")


def _trial(run: "Run", runs: RunStore, study: Study, made: Provenance) -> tuple[Result, Result]:
    """Train a trial's surrogate again, as far as it was trained."""
    from studies.stages.simulate import simulate_stage
    from studies.tuning.training import load_data, train

    spec = made.declaration
    assert spec is not None, "of every trial"
    config = spec.config(made.params)
    simulate_stage(study)  # what is stored is not simulated again
    data = load_data(spec, study.paths)
    history = {
        name: {point.step: point.value for point in runs.client.get_metric_history(run.info.run_id, name)}
        for name in run.data.metrics
        if name.startswith(CURVE)
    }
    last = max((step for curve in history.values() for step in curve), default=0)
    is_pruned = run.data.tags.get("pruned") == "True"
    seen: dict[str, dict[int, float]] = {name: {} for name in history}

    def hear(report: Any) -> None:
        now = {"validation_mae": report.validation_mae, "loss": report.train_loss, **report.terms}
        for name, value in now.items():
            seen.setdefault(f"{CURVE}{name}", {})[report.epoch] = value
        if is_pruned and report.epoch >= last:
            raise _LastEpochError

    numbers: dict[str, float] = {}
    with suppress(_LastEpochError):
        _, numbers = train(spec, config, made.seed, data, on_epoch=hear, on_report=lambda *_: None)
    was = {name: value for name, value in run.data.metrics.items() if not name.startswith(CURVE)}

    def rows(of: Mapping[str, Mapping[int, float]]) -> dict[str, NDArray[Any]]:
        return {name: np.array([of[name].get(step) for step in sorted(history[name])]) for name in history}

    return (was, rows(history)), (numbers, rows(seen))


def _recorded(run: "Run", runs: RunStore, folder: Path) -> Result:
    """Fetch the numbers and arrays of a calibration from its run."""
    stem = f"calibration-{run.info.run_name.removesuffix(' calibration')}"
    numbers = read_json(runs.fetch(run.info.run_id, f"{stem}.json", folder)) or {}
    return numbers, read_arrays(runs.fetch(run.info.run_id, f"{stem}.npz", folder))


def _calibration(study: Study, recipe: FollowedRecipe, _: Result, runs: RunStore) -> Result:
    from studies.stages.calibrate import calibrate
    from studies.tracking.registry import load_surrogate

    surrogate = load_surrogate(runs, str(recipe.surrogate.get("run_id")))
    return calibrate(study, surrogate, recipe.n_train)


def _adaptive(study: Study, recipe: FollowedRecipe, recorded: Result, _: RunStore) -> Result:
    from studies.stages.adaptive import calibrate_adaptively
    from studies.stages.known_rows import Known

    assert recipe.settings is not None, "of every adaptive calibration"
    has_equations, known_rows = "state_equations" in recorded[0], None
    if "known_theta" in recorded[1]:
        known = Known(recorded[1]["known_theta"], recorded[1]["known_watched"])
        known_rows = lambda *_: known  # noqa: E731
    numbers, arrays, _n_simulated = calibrate_adaptively(
        study, recipe.settings, known_rows, state_equations=has_equations
    )
    return numbers, arrays
