"""Make a trial or a calibration again from what its MLflow run holds, and compare every number.

What the run says is compared with the project, never written into it: the case and its files must be here as
they were.
"""

import math
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from pelsvae.epochs import StopTraining
from pelsvae.surrogate import Surrogate
from simulation.errors import InputError
from simulation.foreign_text import shortened
from studies.calibration.search.adaptive import Adaptive
from studies.paths import ProjectPaths, folder_name
from studies.results.objective import ObjectiveDeclaration
from studies.results.outcome import read_manifest
from studies.results.provenance import FILE, Provenance, case_of, read_provenance
from studies.results.saved import arrays_of, plain, read_arrays, rebuilt
from studies.results.stage_results import SURROGATE_FIELDS, Calibration
from studies.stages.adaptive_stage import calibrate_adaptively
from studies.stages.calibrate_stage import calibrate
from studies.stages.learn import written_drive
from studies.stages.simulate_stage import simulate_stage
from studies.stages.warm_start import ChooseRows, StartRows
from studies.task import Task
from studies.tracking.origin import environment
from studies.tracking.runs import CURVE, VALIDATION_MAE, RunStore, load_surrogate, run_store
from studies.tracking.sent_runs import sent_runs
from studies.tuning.attempts import RUN_ID
from studies.tuning.live_trial import Objective
from studies.tuning.means import judge, mean_of, share_name
from studies.tuning.objectives import imported, source_of, tune_objective
from studies.tuning.trial_training import Training, load_data, load_drive
from studies.words.console import Column, Console

if TYPE_CHECKING:
    from mlflow.entities import Run

Numbers = Mapping[str, Any]
"""Nested JSON values and arrays by name."""
OF_THE_STORE = (
    "n_simulated",
    "n_repeated",
    "has_own_processes",
    *(f"screening.{of}" for of in SURROGATE_FIELDS),
)
"""Of a calibration: what depends on what is stored, or says which surrogate was taken."""


@dataclass(frozen=True)
class Compared:
    """One number, text or row of numbers, recorded and made again.

    Args:
        name: what it is.
        recorded: as it was recorded, in all its digits.
        now: as it came out now.
        is_equal: whether they are the same to the last digit.
        relative: largest difference over the recorded value; None where it has no meaning. [1]
    """

    name: str
    recorded: str
    now: str
    is_equal: bool
    relative: float | None = None


def reproduce(
    paths: ProjectPaths,
    name: str,
    console: Console,
    *,
    n_jobs: int,
    objective: Objective | str | None = None,
) -> tuple[str, list[Compared]]:
    """Make the result of a run again.

    Args:
        paths: the project.
        name: id of an MLflow run, or a calibration as `studies status` names it.
        console: says what is done.
        n_jobs: processes for simulations.
        objective: the function, or "module:function", of a trial of a user's objective; no record names what
            is run.

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
        record = runs.record(run_id, Path(scratch))
        if record.get("kind") == "objective":
            with console.stage("reproduce", f"{run.info.run_name} once more"):
                apart = ProjectPaths(Path(scratch) / "project")
                return run_id, compare(*_of_objective(run, runs, record, apart, console, objective))
        made = read_provenance(record, f"MLflow's run {run_id}")
        case = case_of(paths, made, exactly=True)
        task = Task(case, made.profile, paths, console, n_jobs, made.label, made.command)
        _say_differences(console, made.environment, environment())
        what = f"{run.info.run_name} of {task.label} once more"
        with console.stage("reproduce", what), threadpool_limits(made.n_threads):
            if made.kind == "mean":
                recorded, now = _mean(run, runs, task, made)
            elif made.declaration is not None:
                recorded, now = _trial(run, runs, task, made)
            else:
                stage = f"calibrate-{run.info.run_name.removesuffix(' calibration')}"
                arrays = read_arrays(runs.fetch(run_id, f"{stage}.npz", Path(scratch)))
                # In a folder of its own, so that stored rows are simulated again as well.
                apart = replace(task, paths=ProjectPaths(Path(scratch) / "project"))
                before = rebuilt(Calibration, record.get("result"), FILE, arrays)
                again = _calibration(apart, made, before, runs)
                recorded, now = ({**plain(one), **arrays_of(one)} for one in (before, again))
    return run_id, compare(recorded, now)


def compare(recorded: Numbers, now: Numbers) -> list[Compared]:
    """Compare every number that was recorded.

    Args:
        recorded: as it was.
        now: the same made again; what was not recorded is left out.
    """
    again = dict(_leaves(now))
    was = [(name, value) for name, value in _leaves(recorded) if not name.startswith(OF_THE_STORE)]
    return [_compared(name, value, again.get(name)) for name, value in was]


def show_reproduction(console: Console, run_id: str, rows: Sequence[Compared]) -> None:
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


def _leaves(content: Numbers, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _compared(name: str, recorded: Any, now: Any) -> Compared:
    was, is_now = np.asarray(recorded), np.asarray(now)
    before, after = (f"{one.size} values" if one.ndim else repr(one.item()) for one in (was, is_now))
    are_numbers = was.dtype.kind in "iuf" and is_now.dtype.kind in "iuf" and was.shape == is_now.shape
    if np.array_equal(was, is_now, equal_nan=are_numbers):
        return Compared(name, before, after, True, 0.0 if are_numbers else None)
    if not are_numbers:
        return Compared(name, before, after, False)
    with np.errstate(all="ignore"):
        relative = float(np.nanmax(np.abs(is_now - was)) / max(np.nanmax(np.abs(was)), 1e-300))
    return Compared(name, before, after, False, relative if np.isfinite(relative) else None)


def _find(runs: RunStore, name: str) -> "Run":
    """Find a run by its id, or that of the stored calibration of a name, else the latest one."""
    from mlflow.exceptions import MlflowException

    with suppress(MlflowException):
        if re.fullmatch(r"[0-9a-f]{32}", name):
            # Or its id on the project's server.
            sent = sent_runs(runs.paths)
            return runs.client.get_run((sent.run_of(name) if sent else None) or name)
        label, _, stage = name.partition("/")
        found = runs.client.get_experiment_by_name(label)
        named = runs.find(label, {"role": "calibration"}) if found else []
        if named := [run for run in named if stage == run.info.run_name.removesuffix(" calibration")]:
            # That of the stored result, whatever the clock said when others were made.
            stored = read_manifest(runs.paths.results(label), folder_name(f"calibrate-{stage}")) or {}
            return max(
                reversed(named), key=lambda run: run.data.tags.get("stage_key") == stored.get("digest")
            )
    known = "an MLflow run's id (`studies best --json` has some) or a calibration as in `studies status`"
    raise InputError(f"nothing is called {name!r}; give {known}")


def _say_differences(console: Console, was: Mapping[str, str], now: Mapping[str, str]) -> None:
    """Say which packages, code and machine differ from the recorded ones."""
    for key in sorted(set(was) | set(now)):
        if was.get(key) != now.get(key) and key != "device":
            before, after = (shortened(one.get(key, "–"), 40) for one in (was, now))
            console.say(f"  {key}: {before} -> {after}")


def _trial(run: "Run", runs: RunStore, task: Task, made: Provenance) -> tuple[Numbers, Numbers]:
    """Train a trial's surrogate again, as far as it was trained."""
    spec = made.declaration
    assert spec is not None, "of every trial"
    config = spec.config(made.params)
    simulate_stage(task)  # what is stored is not simulated again
    written_drive(task)
    data, drive = load_data(spec, task.paths), load_drive(spec, task.paths)
    curve = f"{CURVE}{VALIDATION_MAE}"  # which is as sensitive as any other
    history = {point.step: point.value for point in runs.client.get_metric_history(run.info.run_id, curve)}
    is_pruned, seen = run.data.tags.get("pruned") == "True", dict[int, float]()

    def on_epoch(report: Any) -> None:
        if math.isnan(report.validation_mae):  # between the folds of a cross-validation nothing is judged
            return
        seen[report.epoch] = report.validation_mae
        if is_pruned and report.epoch >= max(history, default=0):
            raise StopTraining("as far as it was trained then")

    numbers: dict[str, float] = {}
    with suppress(StopTraining):  # of processes, which are not judged before their end
        _, numbers = Training(spec, config, made.seed, data, drive).judged(on_epoch=on_epoch)
    was = {name: run.data.metrics[name] for name in numbers if name in run.data.metrics}
    again = [seen.get(step) for step in history]
    return {**was, curve: [*history.values()]}, {**numbers, curve: again}


def _of_objective(
    run: "Run",
    runs: RunStore,
    record: Mapping[str, Any],
    apart: ProjectPaths,
    console: Console,
    objective: Objective | str | None,
) -> tuple[Numbers, Numbers]:
    """Call a user's function again, as the trial of a study in a project of its own."""
    run_id = str(run.info.run_id)
    if objective is None:
        named = f"--objective {shortened(str(record.get('objective')))}"
        raise InputError(f"no record says what is run; type: studies reproduce {run_id} {named}")
    function = imported(objective) if isinstance(objective, str) else objective
    if (source := source_of(function))["source_sha256"] != record.get("source_sha256"):
        console.say(f"  {source['objective']}: its file has changed since")
    spec = rebuilt(ObjectiveDeclaration, record.get("declaration"), f"MLflow's run {run_id}: {FILE}")
    alone = replace(spec, pruner={"name": "NopPruner"}, enqueue=(), max_trial_s=None, project="")
    again = tune_objective(
        alone, function, paths=apart, n_trials=1, n_jobs=1, n_parallel=1, provenance=source, given=record
    )
    (made,) = again.trials
    if reason := made.user_attrs.get("reason"):
        console.say(f"  it failed now: {reason}")
    store, recorded, now = RunStore(apart), dict[str, Any](), dict[str, Any]()
    made_in = store.record(made.user_attrs[RUN_ID], apart.root)["environment"]
    _say_differences(console, record.get("environment", {}), made_in)
    for name in run.data.metrics:
        was, after = (
            {one.step: one.value for one in client.get_metric_history(of, name)}
            for client, of in ((runs.client, run_id), (store.client, made.user_attrs[RUN_ID]))
        )
        # As far as a pruned trial came.
        curves = [*was.values()], [after.get(step) for step in was]
        recorded[name], now[name] = (one if len(was) > 1 else one[0] for one in curves)
    return recorded, now


def _mean(run: "Run", runs: RunStore, task: Task, made: Provenance) -> tuple[Numbers, Numbers]:
    """Train all parts of a mean again, and weigh them."""
    assert made.declaration is not None, "of every mean"
    simulate_stage(task)
    written_drive(task)
    parts, data = list[Surrogate](), load_data(made.declaration, task.paths)
    with tempfile.TemporaryDirectory(prefix="studies-reproduce-") as scratch:
        for run_id in made.parts:
            folder = Path(scratch) / run_id  # of a run whose artifacts are copied
            folder.mkdir()
            record = runs.record(run_id, folder)
            own = read_provenance(record, f"MLflow's run {run_id}")
            if own.kind != "training" or own.declaration is None:
                raise InputError(f"MLflow's run {run_id} is no trial; it cannot be a part of a mean")
            spec, config = own.declaration, own.declaration.config(own.params)
            task.console.say(f"  {spec.size}: training run {run_id} again")
            sets, drive = load_data(spec, task.paths), load_drive(spec, task.paths)
            fitted, _ = Training(spec, config, own.seed, sets, drive).judged()
            assert fitted is not None, "means are judged by a validation set"
            parts.append(fitted.surrogate)
    mean, used = mean_of(made.declaration, parts, data)
    shares = {share_name(k): share for k, share in zip(used, mean.shares, strict=True)}
    now = {**judge(mean, made.declaration, data), **shares}
    return {name: run.data.metrics[name] for name in now if name in run.data.metrics}, now


def _calibration(task: Task, made: Provenance, before: Calibration, runs: RunStore) -> Calibration:
    start: ChooseRows | None = None
    if before.start_theta is not None and before.start_watched is not None:
        rows = StartRows(before.start_theta, before.start_watched)
        start = lambda *_: rows  # noqa: E731 (the rows are known)
    if made.settings is None:
        return calibrate(task, load_surrogate(runs, made.surrogate_run), made.n_train, start=start)
    settings = rebuilt(Adaptive, made.settings, FILE)
    learns = before.state_equations is not None
    return calibrate_adaptively(task, settings, start, state_equations=learns)
