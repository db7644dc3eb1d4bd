"""Open the task that keywords name: a case and a profile, with what changes them."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError, MachineError
from studies.keywords import Window, as_text, window
from studies.paths import find_case, find_project, mark_project
from studies.words.console import Console
from studies.words.wording import count

if TYPE_CHECKING:
    from simulation.case import Case
    from studies.profile import Profile
    from studies.task import Task


FOLDS = 5
"""Of a cross-validation where a profile does not say how many."""
LEAST_SIZE = 8
"""Rows that a surrogate is learnt from at least."""
LEAST_BEYOND, LEAST_POLISH = 16, 6
"""Simulations of a budget at least beyond one per parameter, and beyond the largest training set."""


def open_task(verb: str, given: Mapping[str, Any], console: Console, typed: str) -> "Task":
    """Open the task of a case and a profile, with the keywords that change them.

    Args:
        verb: What is done: the name of a command.
        given: Keywords of that command; those that it does not have stand for their defaults.
        console: Shows progress and results.
        typed: The command line that does the same, for records.

    Raises:
        InputError: A keyword is wrong, or the label holds results of another case file.
    """
    from studies.profile import load_profile

    paths, is_dry = find_project(given.get("storage"), given.get("tracking")), bool(given.get("dry_run"))
    profile, file = load_profile(str(given["profile"])), find_case(paths, str(given["case"]))
    changed = _changed(profile, verb, given)
    # Heavy imports wait until the keywords are known to be good.
    from simulation.pool.pool_model import available_cores
    from studies.stages.finished import refuse_other_case
    from studies.task import Task

    case, part = _load_case(file, _window(given.get("window")))
    label = f"{case.name}-{profile.name}" + ("" if part is None else f"-{part.label}")
    label += f"-seed{changed.seed}" if changed.seed != profile.seed else ""
    if (n := changed.budget.simulations) != profile.budget.simulations:
        label += f"-sim{n}"
    changed = sized(changed, case)
    is_other = changed.tuning.surrogate != profile.tuning.surrogate
    task = Task(
        case=case,
        profile=changed,
        paths=paths,
        console=console,
        n_jobs=given.get("jobs") or available_cores(),
        label=label + (f"-{changed.tuning.surrogate}" if is_other else ""),
        command=_command(given, part),
        typed=typed,
        retry_failed=bool(given.get("retry_failed")),
        dask=given.get("dask"),
        max_hours=given.get("max_hours"),
    )
    # Before anything else: some stages take away what is no longer whole before they begin.
    refuse_other_case(task)
    if is_dry:
        return task
    mark_project(paths, console)
    if paths.storage is not None and verb != "check":
        from studies.tuning.storage import open_storage

        open_storage(paths)  # now, not after hours of work that cannot be kept there
    return task


def sizes(n_train: int | Sequence[int] | None) -> list[int]:
    """Return training-set sizes as a list: one number is a list of one, None is an empty one."""
    return [] if n_train is None else [*n_train] if isinstance(n_train, Sequence) else [n_train]


def _window(value: Any) -> Window | None:
    """Return the window that a text, two days or a window mean."""
    if value is None or isinstance(value, Window):
        return value
    return window(as_text(value))


def _changed(profile: "Profile", verb: str, keywords: Mapping[str, Any]) -> "Profile":
    """Return a profile with what keywords change in it."""
    from studies.profile import Budget

    given = {name: value for name, value in keywords.items() if value is not None}
    data, tuning, polish = profile.data, profile.tuning, profile.polish
    sensitivity = replace(profile.sensitivity, model="fmu") if given.get("fmu") else profile.sensitivity
    if "n_train" in given and verb not in ("calibrate", "uncertainty", "predict", "next_experiment"):
        data = replace(data, n_train=tuple(sorted(set(sizes(given["n_train"])))))
    if given.get("surrogate", tuning.surrogate) != tuning.surrogate:
        # The search space of one form says nothing about another.
        tuning = replace(tuning, surrogate=given["surrogate"], search=None)
    n_trials, n_parallel = given.get("trials", tuning.n_trials), given.get("parallel", tuning.n_parallel)
    tuning = replace(tuning, n_trials=n_trials, n_parallel=n_parallel)
    if "max_calls" in given and verb != "uncertainty":
        polish = replace(polish, max_calls=given["max_calls"])
    seed = given.get("seed", profile.seed)
    changed = replace(profile, seed=seed, data=data, tuning=tuning, polish=polish, sensitivity=sensitivity)
    if "simulations" in given:
        data = data if "n_train" in given else replace(data, n_train=())
        return replace(changed, budget=Budget(given["simulations"]), data=data)
    return changed


def sized(profile: "Profile", case: "Case") -> "Profile":
    """Return a profile with the training-set sizes that follow from its budget, where it names none.

    They double from about as many rows as there are parameters, up to half of the budget, so that the other
    half is left to polish. Surrogates are judged by cross-validation, as no simulation is left to judge.

    Raises:
        InputError: the budget does not hold the sizes.
    """
    n, p = profile.budget.simulations, case.parameter_space.n_parameters
    if n is None:
        return profile
    if n < p + LEAST_BEYOND:
        raise InputError(
            f"--simulations {n} is not enough for {count(p, 'parameter')}; give {p + LEAST_BEYOND} or more"
        )
    n_train = profile.data.n_train
    if not n_train:
        first = max(LEAST_SIZE, 1 << (p + 2).bit_length() - 1)
        doubled = [first << step for step in range(n.bit_length())]
        n_train = tuple(one for one in doubled if one == first or one <= n // 2)
    if max(n_train) + LEAST_POLISH > n:
        raise InputError(
            f"--n-train {max(n_train)} leaves too little of --simulations {n}; give a smaller size, "
            f"or --simulations {max(n_train) + LEAST_POLISH}"
        )
    data = replace(profile.data, n_train=n_train, folds=profile.data.folds or FOLDS)
    return replace(profile, data=data)


def _load_case(file: Path, part: Window | None) -> "tuple[Case, Window | None]":
    """Read a case, compared over a window; its own window has no name and is returned as None.

    Raises:
        InputError: the case is wrong; an error that only the window causes names the window.
    """
    from simulation.case import load_case

    case = load_case(file)
    if part is None or part.days == case.window_d:
        return case, None
    try:
        return load_case(file, window_d=part.days), part
    except MachineError:
        raise
    except InputError as error:
        raise InputError(f"--window {part}: {error}") from error


def _command(given: Mapping[str, Any], part: Window | None) -> str:
    """Return the words that name a task on a command line."""
    words = [str(given["case"])]
    if given["profile"] != "quick":
        words += ["--profile", str(given["profile"])]
    if simulations := given.get("simulations"):
        words += ["--simulations", str(simulations)]
    if surrogate := given.get("surrogate"):
        words += ["--surrogate", surrogate]
    if part is not None:
        words += ["--window", str(part)]
    if given.get("seed") is not None:
        words += ["--seed", str(given["seed"])]
    return shlex.join(words)
