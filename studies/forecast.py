"""What a command would do: simulations and trials to go, and how long they take."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from simulation.errors import InputError
from simulation.pool.pool_model import PoolModel
from studies.opening import sizes
from studies.physical_model import store_file
from studies.simulation_time import Timed, known_time, shown_time
from studies.stages.adaptive_stage import MAX_CALLS
from studies.stages.learn import require_tuning
from studies.stages.simulate_stage import missing_rows
from studies.stages.tuned_trials import tuned_by_size
from studies.stages.uncertainty_stage import usual_calls
from studies.task import Task
from studies.tuning.confirmations import to_confirm
from studies.words.console import Column, format_seconds
from studies.words.wording import count

WORDS = {
    "simulate": "simulations of the sets",
    "sensitivity": "simulations for Sobol indices, at most",
    "polish": "simulations for polishing, at most",
    "search": "simulations, at most",
    "budget": "simulations of the whole run, at most",
}
LONG_S = 3600.0
"""A run that takes longer says so before it begins."""
N_TIMED, QUICK_S = 4, 1.0
"""Simulations that are timed where none was before, of those that take less than a second; else one."""


def foretell(task: Task, command: str, given: Mapping[str, Any]) -> None:
    """Show what is left to do, as a table or as JSON values; writes nothing.

    Args:
        task: the task.
        command: "run", "simulate", "sensitivity", "tune", "calibrate" or "uncertainty".
        given: its options.

    Raises:
        InputError: a sampler, a pruner or a device does not exist, or a simulation fails.
    """
    if command in ("run", "tune"):
        require_tuning(task)
    timed = time_simulations(task)
    # A search asks one after the other, each in a process of its own; sets share processes.
    is_search = command in ("calibrate", "uncertainty")
    n_workers = min(given.get("parallel") or 1, task.n_jobs) if is_search else task.n_jobs
    each_s = timed.simulation_s + timed.opening_s * is_search
    plan = [
        {"stage": stage, "n_simulations": n, "simulations_s": n * each_s / n_workers}
        for stage, n in _simulations(task, command, given)
    ]
    trials = list(_trials(task)) if command in ("run", "tune") else []
    rows: list[list[object]] = [
        [WORDS[one["stage"]], one["n_simulations"], shown_time(one["simulations_s"])] for one in plan
    ]
    for one in trials:
        left_s = one["training_s"]
        time = "unknown before the first trial" if left_s is None else format_seconds(left_s)
        rows.append([f"trials, n_train {one['n_train']}, on one core", one["n_left"], time])
    columns = [Column("what"), Column("to do", True), Column("time", True)]
    how = f"{shown_time(each_s)} each, {count(n_workers, 'at a time', 'at a time')}"
    task.console.table(f"{task.label}: what would be done ({how}; nothing is written)", columns, rows)
    if is_search:
        task.console.result("Between two simulations the search thinks: mostly less than 0.2 s.")
    task.console.document(
        {
            "command": command,
            "label": task.label,
            "dry_run": True,
            "n_simulations": 0 if is_search or not plan else plan[0]["n_simulations"],
            "simulation_s": timed.simulation_s,
            "plan": plan,
            "sizes": trials,
            "store": task.paths.show(store_file(task.paths, task.case)),
        }
    )


def time_simulations(task: Task) -> Timed:
    """Return how long a simulation takes, as it was measured before, or measured now.

    Raises:
        InputError: it fails.
    """
    if (known := known_time(task.paths, task.case)) is not None:
        return known
    # Of several experiments one stands for the others.
    n = max(len(task.case.experiments), 1)
    case = next(iter(task.case.experiments), task.case)
    theta = case.parameter_space.expected[None]
    task.console.say("timing a simulation, as none is known")
    with PoolModel(case.make_model, 1, policy=case.policy) as model:
        for n_done in range(N_TIMED):
            answer = model.simulate(theta)
            if answer.failed[0]:
                raise InputError(
                    f"a simulation fails: {answer.failures[0]}; type: studies check {task.command}"
                )
            if n_done and (model.simulation_s or 0.0) > QUICK_S:
                break
        return Timed(n * (model.simulation_s or 0.0), n * model.opening_s)


def warn_of_hours(task: Task) -> None:
    """Name the time of a run whose simulations take more than an hour, and commands that take fewer."""
    timed = known_time(task.paths, task.case)
    if timed is None:
        return
    n, each_s = sum(n for _, n in _simulations(task, "run", {})), timed.simulation_s
    if n * each_s / task.n_jobs <= LONG_S:
        return
    cheaper = {
        f"studies run {task.case.name} --simulations {MAX_CALLS}": MAX_CALLS * each_s / task.n_jobs,
        f"studies calibrate {task.case.name}": MAX_CALLS * each_s,
    }
    task.console.warn(
        f"up to {count(n, 'simulation')} are to come, {shown_time(each_s)} each: about "
        f"{shown_time(n * each_s / task.n_jobs)} in all; "
        + ", ".join(f"`{command}` takes at most {shown_time(s)}" for command, s in cheaper.items())
    )


def _simulations(task: Task, command: str, given: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Give how many simulations are left, or may be asked at most, by stage."""
    n_polish, n_parameters = task.profile.polish.max_calls, task.case.parameter_space.n_parameters
    budget = task.profile.budget.simulations
    if command == "uncertainty":
        yield "search", given.get("max_calls") or usual_calls(n_parameters)
    elif command == "calibrate" and (given.get("method") == "paper" or given.get("n_train")):
        yield "polish", n_polish * (len(sizes(given.get("n_train"))) or len(tuned_by_size(task)))
    elif command == "calibrate":
        yield "search", given.get("max_calls") or MAX_CALLS
    elif command == "run" and budget is not None:
        yield "budget", budget
    else:
        if command != "sensitivity":
            yield "simulate", missing_rows(task)[0]
        if command in ("run", "sensitivity") and task.profile.sensitivity.model == "fmu":
            yield "sensitivity", task.profile.sensitivity.n_base * (n_parameters + 2)
        if command == "run":
            yield "polish", n_polish * len(task.profile.data.n_train)


def _trials(task: Task) -> Iterator[dict[str, Any]]:
    """Give how many trials are left of each size, and their time on one core; None before the first one."""
    budget, known = task.profile.tuning, tuned_by_size(task)
    for n_train in task.profile.data.n_train:
        found, n_confirm = known.get(n_train), 0
        if budget.confirm is not None:
            n_confirm = budget.confirm.seeds * (budget.confirm.top + 1)
            if found is not None and found.usable:
                n_confirm = sum(n_missing for _, n_missing in to_confirm(found, budget.confirm))
        alone = None if found is None else found.of(found.spec.name)
        n_left = max(budget.n_trials - (0 if alone is None else alone.n_ended), 0) + n_confirm
        left_s = None if alone is None else replace(alone, n_planned=alone.n_ended + n_left).to_go_s
        yield {"n_train": n_train, "n_left": n_left, "training_s": left_s}
