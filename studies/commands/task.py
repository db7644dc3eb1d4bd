"""What commands share: open the study that a command line means, and write its results."""

import argparse
import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError, MachineError
from simulation.write_gate import check_written
from studies.paths import ProjectPaths, find_case, find_project, mark_project
from studies.words.console import Console

if TYPE_CHECKING:
    from simulation.case import Case
    from studies.commands.options import Window
    from studies.profile import Profile
    from studies.results.outcome import Outcome
    from studies.task import Task

OK, FAILED = 0, 1


def open_task(chosen: argparse.Namespace, console: Console) -> "Task":
    """Open the study of a case and a profile, with the options that change them.

    Raises:
        InputError: any of them is wrong, or the label holds results of another case file.
    """
    from studies.profile import load_profile

    paths, is_dry = find_project(chosen.storage), vars(chosen).get("dry_run", False)
    profile, file = load_profile(chosen.profile), find_case(paths, chosen.case)
    changed = _changed(profile, chosen)
    if not is_dry:
        _keep_compiled_loops(paths)
    # Heavy imports wait until the words of the command line are known to be good.
    from simulation.pool.pool_model import available_cores
    from studies.stages.finished import refuse_other_case
    from studies.task import Task

    case, window = _load_case(file, chosen.window)
    label = f"{case.name}-{profile.name}" + ("" if window is None else f"-{window.label}")
    label += f"-seed{changed.seed}" if changed.seed != profile.seed else ""
    is_other = changed.tuning.surrogate != profile.tuning.surrogate
    task = Task(
        case=case,
        profile=changed,
        paths=paths,
        console=console,
        n_jobs=chosen.jobs or available_cores(),
        label=label + (f"-{changed.tuning.surrogate}" if is_other else ""),
        command=_command(chosen, window),
        typed=chosen.typed,
        retry_failed=vars(chosen).get("retry_failed", False),
        dask=vars(chosen).get("dask"),
        max_hours=vars(chosen).get("max_hours"),
    )
    # Before anything else: some stages take away what is no longer whole before they begin.
    refuse_other_case(task)
    if is_dry:
        return task
    mark_project(paths.root, console)
    if paths.storage is not None and chosen.command != "check":
        from studies.tuning.storage import open_storage

        open_storage(paths)  # now, not after hours of work that cannot be kept there
    return task


def _changed(profile: "Profile", chosen: argparse.Namespace) -> "Profile":
    """Return a profile with what the options of the command line change in it."""
    given = {name: value for name, value in vars(chosen).items() if value is not None}
    data, tuning, polish = profile.data, profile.tuning, profile.polish
    if "n_train" in given and chosen.command not in ("calibrate", "uncertainty"):
        data = replace(data, n_train=tuple(sorted(set(given["n_train"]))))
    if given.get("surrogate", tuning.surrogate) != tuning.surrogate:
        # The search space of one form says nothing about another.
        tuning = replace(tuning, surrogate=given["surrogate"], search=None)
    n_trials, n_parallel = given.get("trials", tuning.n_trials), given.get("parallel", tuning.n_parallel)
    tuning = replace(tuning, n_trials=n_trials, n_parallel=n_parallel)
    if "max_calls" in given and chosen.command != "uncertainty":
        polish = replace(polish, max_calls=given["max_calls"])
    seed = given.get("seed", profile.seed)
    return replace(profile, seed=seed, data=data, tuning=tuning, polish=polish)


def _keep_compiled_loops(paths: ProjectPaths) -> None:
    """Keep numba's compiled loops in the project where the installed package cannot be written.

    Otherwise they lie beside the package's byte code. numba's own choice would be the home folder.
    """
    import simulation

    if not os.access(Path(simulation.__file__).parent, os.W_OK):
        check_written(paths.mlruns / "compiled")
        os.environ.setdefault("NUMBA_CACHE_DIR", str(paths.mlruns / "compiled"))


def _load_case(file: Path, window: "Window | None") -> "tuple[Case, Window | None]":
    """Read a case, compared over a window; its own window has no name and is returned as None.

    Raises:
        InputError: the case is wrong; an error that only the window causes names the window.
    """
    from simulation.case import load_case

    case = load_case(file)
    if window is None or window.days == case.window_d:
        return case, None
    try:
        return load_case(file, window_d=window.days), window
    except MachineError:
        raise
    except InputError as error:
        raise InputError(f"--window {window}: {error}") from error


def _command(chosen: argparse.Namespace, window: "Window | None") -> str:
    """Return the words that name this study on a command line."""
    words = [chosen.case]
    if chosen.profile != "quick":
        words += ["--profile", chosen.profile]
    if surrogate := vars(chosen).get("surrogate"):
        words += ["--surrogate", surrogate]
    if window is not None:
        words += ["--window", str(window)]
    if chosen.seed is not None:
        words += ["--seed", str(chosen.seed)]
    return shlex.join(words)


def hand_over(task: "Task", command: str, outcomes: "Sequence[Outcome[Any]]", **extra: Any) -> int:
    """Write the results of stages as one JSON document, where one is wanted, and return the exit code."""
    task.console.document(
        {
            "command": command,
            "case": task.case.name,
            "profile": task.profile.name,
            "label": task.label,
            "note": task.case.note,
            "stages": [outcome.to_dict(task.paths) for outcome in outcomes],
            **extra,
        },
        of=(task, outcomes),
    )
    return OK
