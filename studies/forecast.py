"""What a command would do: simulations to go, trials to go, and their time where earlier trials show it."""

from dataclasses import replace

from studies.physical_model import store_file
from studies.stages.simulate_stage import missing_rows
from studies.stages.tuned_trials import tuned_by_size
from studies.task import Task
from studies.words.console import Column, format_seconds
from studies.words.wording import MISSING


def foretell(task: Task, command: str) -> None:
    """Show what is left to do, as a table or as JSON values; writes nothing.

    Args:
        task: the task.
        command: "run", which does all stages, or "tune", which simulates and tunes alone.
    """
    data, tuning = task.profile.data, task.profile.tuning
    n_missing, n_all = missing_rows(task)
    known = tuned_by_size(task)
    rows: list[list[object]] = [["simulations", f"{n_missing} of {n_all}", MISSING]]
    sizes = []
    for n_train in data.n_train:
        found = known.get(n_train)
        n_left = tuning.n_trials if found is None else max(tuning.n_trials - found.n_ended, 0)
        left_s = None if found is None else replace(found, n_planned=tuning.n_trials).to_go_s
        time = "unknown before the first trial" if left_s is None else format_seconds(left_s)
        rows.append([f"trials, n_train {n_train}", f"{n_left} of {tuning.n_trials}", time])
        sizes.append({"n_train": n_train, "n_left": n_left, "training_s": left_s})
    if command == "run":
        n_base = task.profile.sensitivity.n_base * (task.case.parameter_space.n_parameters + 2)
        n_polish = task.profile.polish.max_calls * len(sizes)
        rows.append(["simulations for Sobol indices, at most", n_base, MISSING])
        rows.append(["simulations for polishing, at most", n_polish, MISSING])
    columns = [Column("what"), Column("to do", True), Column("training time on one core", True)]
    title = f"{task.label}: what would be done (times from the mean of earlier trials; nothing is written)"
    store = task.paths.show(store_file(task.paths, task.case))
    task.console.table(title, columns, rows)
    left = {"n_simulations": n_missing, "sizes": sizes, "store": store}
    task.console.document({"command": command, "label": task.label, "dry_run": True, **left})
