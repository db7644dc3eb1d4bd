"""What commands share: open the study that a command line means, and write its results."""

import argparse
import os
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError, MachineError
from studies.console import Console
from studies.marker import mark_project
from studies.paths import ProjectPaths, find_case, find_project

if TYPE_CHECKING:
    from simulation.case import Case
    from studies.commands.values import Window
    from studies.paths import ProjectPaths
    from studies.stages.pipeline import Outcome, Study

OK, FAILED = 0, 1


def open_study(chosen: argparse.Namespace, console: Console) -> "Study":
    """Open the study of a case and a profile, with the options that change them.

    Raises:
        InputError: any of them is wrong, or the label holds results of another case file.
    """
    from studies.profile import load_profile

    paths = find_project(chosen.storage)
    profile = own_profile = load_profile(chosen.profile)
    label_end = ""
    if chosen.seed is not None and chosen.seed != profile.seed:
        label_end = f"-seed{chosen.seed}"
        profile = replace(profile, seed=chosen.seed)
    given = vars(chosen)
    if given.get("n_train") and chosen.command not in ("calibrate", "uncertainty"):
        profile = replace(profile, data=replace(profile.data, n_train=tuple(sorted(set(given["n_train"])))))
    if given.get("trials"):
        profile = replace(profile, tuning=replace(profile.tuning, n_trials=given["trials"]))
    if given.get("surrogate") and given["surrogate"] != profile.tuning.surrogate:
        # The search space of one form says nothing about another.
        tuning = replace(profile.tuning, surrogate=given["surrogate"], search=None)
        profile = replace(profile, tuning=tuning)
        label_end += f"-{given['surrogate']}"
    if given.get("parallel"):
        profile = replace(profile, tuning=replace(profile.tuning, n_parallel=given["parallel"]))
    if given.get("max_calls") and chosen.command != "uncertainty":
        profile = replace(profile, polish=replace(profile.polish, max_calls=given["max_calls"]))
    file = find_case(paths, chosen.case)
    if not given.get("dry_run"):
        _keep_compiled_loops(paths)
    # Heavy imports wait until the words of the command line are known to be good.
    from simulation.case_reading import read_case_file
    from simulation.pool.pool_model import available_cores
    from studies.stages.one_case import refuse_other_case
    from studies.stages.pipeline import Study

    declared, window = read_case_file(file), chosen.window

    def label_with(window: "Window | None") -> str:
        of_window = "" if window is None else f"-{window.label}"
        return f"{declared.name}-{profile.name}{of_window}{label_end}"

    # The case's own window needs no name; earlier versions gave it one, which goes on.
    is_own = window is not None and window.days == declared.time.window
    if is_own and not paths.results(label_with(window)).is_dir():
        window = None
    case = _load_case(file, window)
    study = Study(
        case=case,
        profile=profile,
        paths=paths,
        console=console,
        n_jobs=chosen.jobs or available_cores(),
        label=label_with(window),
        command=_command(chosen, window),
        retry_failed=given.get("retry_failed", False),
        dask=given.get("dask"),
        max_hours=given.get("max_hours"),
        own_profile=own_profile,
    )
    # Before anything else: some stages take away what is no longer whole before they begin.
    refuse_other_case(study)
    refuse_old_project(paths)
    if not given.get("dry_run"):
        mark_project(paths.root, console)
    if paths.storage is not None and chosen.command != "check" and not given.get("dry_run"):
        from studies.tuning.storage import open_storage

        open_storage(paths)  # now, not after hours of work that cannot be kept there
    return study


def refuse_old_project(paths: "ProjectPaths") -> None:
    """Refuse a project whose trials an earlier version kept in files of its own.

    Raises:
        InputError: there is such a project; nothing of it is touched.
    """
    old = [name for name in ("optuna.journal", "trials", "champions") if (paths.mlruns / name).exists()]
    if old:
        raise InputError(
            f"{paths.show(paths.mlruns)} holds studies of version 0.2 ({', '.join(old)}), which this version "
            "does not read; move that folder away, or work in another folder"
        )


def _keep_compiled_loops(paths: ProjectPaths) -> None:
    """Keep numba's compiled loops in the project where the installed package cannot be written.

    Elsewhere they lie beside the package's byte code. numba's own choice would be the home folder.
    """
    import simulation

    if not os.access(Path(simulation.__file__).parent, os.W_OK):
        os.environ.setdefault("NUMBA_CACHE_DIR", str(paths.mlruns / "compiled"))


def _load_case(file: Path, window: "Window | None") -> "Case":
    """Read a case.

    Raises:
        InputError: the case is wrong; an error that only the window causes names the window.
    """
    from simulation.case import load_case

    if window is None:
        return load_case(file)
    try:
        return load_case(file, window_d=window.days)
    except MachineError:
        raise
    except InputError as error:
        load_case(file)
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


def foretell(study: "Study", command: str, *, whole: bool) -> int:
    """Show the plan of a command and the duration of its tuning, and return the exit code.

    Args:
        study: the study.
        command: the command.
        whole: whether it does all stages, or simulations and tuning alone.
    """
    from studies.forecast import forecast

    table, document = forecast(study, whole=whole)
    study.console.show([table])
    study.console.document({"command": command, "label": study.label, "dry_run": True, **document})
    return OK


def hand_over(study: "Study", command: str, outcomes: "list[Outcome]", **extra: Any) -> int:
    """Write the results of stages as one JSON document, where one is wanted, and return the exit code."""
    study.console.document(
        {
            "command": command,
            "case": study.case.name,
            "profile": study.profile.name,
            "label": study.label,
            "note": study.case.note,
            "stages": [outcome.to_dict(study.paths) for outcome in outcomes],
            **extra,
        }
    )
    return OK
