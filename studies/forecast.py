"""What a command would do: simulations and trials to go, and how long they take."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from simulation.errors import InputError
from simulation.pool.pool_model import PoolModel
from studies.doctor.finding import Diagnosis
from studies.opening import sizes
from studies.physical_model import store_file
from studies.stages.adaptive_stage import MAX_CALLS
from studies.stages.finished import stored
from studies.stages.learn import require_tuning
from studies.stages.simulate_stage import missing_rows
from studies.stages.tuned_trials import tuned_by_size
from studies.task import Task
from studies.words.console import Column, format_seconds
from studies.words.wording import count, significant

WORDS = {
    "simulate": "simulations of the sets",
    "sensitivity": "simulations for Sobol indices, at most",
    "polish": "simulations for polishing, at most",
    "search": "simulations, at most",
}
N_TIMED, QUICK_S = 4, 1.0
"""Simulations that are timed where none was before, of those that take less than a second; else one."""


def foretell(task: Task, command: str, given: Mapping[str, Any]) -> None:
    """Show what is left to do, as a table or as JSON values; writes nothing.

    Args:
        task: the task.
        command: "run", "tune" or "calibrate".
        given: its options.

    Raises:
        InputError: a sampler, a pruner or a device does not exist, or a simulation fails.
    """
    if command != "calibrate":
        require_tuning(task)
    timed = time_simulations(task)
    # A search asks one after the other, each in a process of its own; sets share processes.
    is_search = command == "calibrate"
    n_workers = min(given.get("parallel") or 1, task.n_jobs) if is_search else task.n_jobs
    each_s = timed.simulation_s + timed.opening_s * is_search
    plan = [
        {"stage": stage, "n_simulations": n, "simulations_s": n * each_s / n_workers}
        for stage, n in _simulations(task, command, given)
    ]
    trials = [] if is_search else list(_trials(task))
    rows: list[list[object]] = [
        [WORDS[one["stage"]], one["n_simulations"], _shown(one["simulations_s"])] for one in plan
    ]
    for one in trials:
        left_s = one["training_s"]
        time = "unknown before the first trial" if left_s is None else format_seconds(left_s)
        rows.append([f"trials, n_train {one['n_train']}, on one core", one["n_left"], time])
    columns = [Column("what"), Column("to do", True), Column("time", True)]
    how = f"{_shown(each_s)} each, {count(n_workers, 'at a time', 'at a time')}"
    task.console.table(f"{task.label}: what would be done ({how}; nothing is written)", columns, rows)
    if is_search:
        task.console.result("Between two simulations the search thinks: mostly less than 0.2 s.")
    task.console.document(
        {
            "command": command,
            "label": task.label,
            "dry_run": True,
            "n_simulations": 0 if is_search else plan[0]["n_simulations"],
            "simulation_s": timed.simulation_s,
            "plan": plan,
            "sizes": trials,
            "store": task.paths.show(store_file(task.paths, task.case)),
        }
    )


class Timed(NamedTuple):
    """What a simulation takes.

    Attributes:
        simulation_s: The simulation. [s]
        opening_s: A process that opens the model; 0 where that was not measured. [s]
    """

    simulation_s: float
    opening_s: float = 0.0


def time_simulations(task: Task) -> Timed:
    """Return how long a simulation takes, as `studies check` has measured it, or measured now.

    Raises:
        InputError: it fails.
    """
    checked = stored(task, "check", Diagnosis)
    if checked is not None and checked.simulation_s > 0.0:
        return Timed(checked.simulation_s)
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


def _simulations(task: Task, command: str, given: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Give how many simulations are left, or may be asked at most, by stage."""
    n_polish, n_parameters = task.profile.polish.max_calls, task.case.parameter_space.n_parameters
    if command != "calibrate":
        yield "simulate", missing_rows(task)[0]
        if command == "run":
            yield "sensitivity", task.profile.sensitivity.n_base * (n_parameters + 2)
            yield "polish", n_polish * len(task.profile.data.n_train)
    elif given.get("method") == "paper" or given.get("n_train"):
        yield "polish", n_polish * (len(sizes(given.get("n_train"))) or len(tuned_by_size(task)))
    else:
        yield "search", given.get("max_calls") or MAX_CALLS


def _trials(task: Task) -> Iterator[dict[str, Any]]:
    """Give how many trials are left of each size, and their time on one core; None before the first one."""
    n_trials, known = task.profile.tuning.n_trials, tuned_by_size(task)
    for n_train in task.profile.data.n_train:
        found = known.get(n_train)
        n_left = n_trials if found is None else max(n_trials - found.n_ended, 0)
        left_s = None if found is None else replace(found, n_planned=n_trials).to_go_s
        yield {"n_train": n_train, "n_left": n_left, "training_s": left_s}


def _shown(seconds: float) -> str:
    """Write a duration; a short one in milliseconds."""
    return f"{significant(1000.0 * seconds)} ms" if 0.0 < seconds < 1.0 else format_seconds(seconds)
