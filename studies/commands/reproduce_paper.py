"""Repeat tables and figures of the paper beside its numbers.

What happens: tables and figures of the paper are made one after the other, from simulations, trainings and
calibrations that the other commands share. Finished ones are not repeated; an interrupted item goes on
where it stopped. Each item prints a table with the values of the paper. Its numbers (JSON) and, for a
figure, its picture (PNG) are in mlruns/results/<label>/paper/<item>/ and in MLflow. Figs. 4 and 5 of the
paper, trajectories and Sobol indices, are in the page of studies report.

--budget small (default) takes about an hour on two cores, --budget full up to twelve. The full budget uses
the trainings of the small one. --profile takes sizes and trials of another profile, for example smoke as a
test, or paper for the networks as the paper describes them.

Fig. 7 and Table 4 train the best network of each size in Fig. 6 once more. --hyperparameters FOLDER takes
these from the trials of an earlier Fig. 6, so that nothing is tuned.

--from FOLDER draws Fig. 6, Fig. 7 or Table 4 from the files of an earlier run. Nothing is simulated or
trained, and the recording is not needed. A clone of the repository has such files in data/paper-results.

Examples:
  studies reproduce-paper --dry-run                         what is made, and with how many trials
  studies reproduce-paper --only fig6 fig7
  studies reproduce-paper office-recorded --budget full     after studies import-recording
  studies reproduce-paper office-recorded --only fig6 --from data/paper-results/fig6
  studies reproduce-paper office-recorded --only table4 --hyperparameters data/paper-results/fig6
"""

import argparse
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError
from studies.api.verb import begun_anew
from studies.commands import options
from studies.commands.hand_over import OK
from studies.commands.options import Option
from studies.keywords import whole
from studies.opening import open_task
from studies.paper import ALIASES, DRAWN, ITEMS, NEEDS_FIG6
from studies.paths import find_project
from studies.words.console import Column, Console
from studies.words.wording import cell_text, listed

if TYPE_CHECKING:
    from studies.paper.items import Shown
    from studies.paper.plan import Plan
    from studies.task import Task

PROFILE = "thorough"
WORDS = (*ITEMS, *ALIASES)

OPTIONS = (
    *options.NAME,
    *options.TRIALS,
    Option("--only", nargs="+", choices=WORDS, metavar="ITEM", help=f"only these items: {', '.join(WORDS)}"),
    Option("--budget", choices=("small", "full"), metavar="NAME", help="small (default) or full"),
    Option("--profile", metavar="NAME", help=f"sizes and trials of another profile; default: {PROFILE}"),
    Option("--seeds", type=whole(1, 1000), metavar="N", help="number of seeds of Table 4 at small sizes"),
    Option(
        "--from",
        dest="source",
        type=Path,
        metavar="FOLDER",
        help="with --only fig6, fig7 or table4: draw it from the files of an earlier run",
    ),
    Option(
        "--hyperparameters",
        type=Path,
        metavar="FOLDER",
        help="with fig7 or table4: take the best trials of Fig. 6 from here instead of tuning",
    ),
    *options.SIMULATION,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    return begun_anew(partial(_run, chosen, console), console)


def _run(chosen: argparse.Namespace, console: Console) -> int:
    from studies.paper.items import make

    wanted = {ALIASES.get(word, word) for word in chosen.only or ITEMS}
    if chosen.source is not None:
        return _drawn(chosen, wanted, console)
    if chosen.hyperparameters is None and wanted & set(NEEDS_FIG6):
        wanted.add("fig6")
    items = [item for item in ITEMS if item in wanted]
    plan = _plan(chosen, console)
    task, budget = plan.task, plan.budget
    console.table(
        f"{task.label}: {budget.name} budget",
        [Column("item"), Column("what")],
        [[item, ITEMS[item]] for item in items],
    )
    trials = ", ".join(f"{n}: {n_trials}" for n, n_trials in budget.trials.items())
    console.result(f"Trials by training-set size: {trials}")
    document = {"command": "reproduce-paper", "label": task.label, "budget": asdict(budget)}
    if chosen.dry_run:
        console.document({**document, "items": items, "dry_run": True})
        return OK
    made = {}
    for item in items:
        shown, files = make(plan, item)
        _show(shown, [task.paths.show(file) for file in files], console)
        made[item] = task.paths.show(files[0])
    console.document({**document, "items": made})
    return OK


def _show(shown: "Shown", files: list[str], console: Console) -> None:
    """Print the table of an item and where its files lie."""
    columns = [
        Column(title, not any(isinstance(row[k], str) for row in shown.rows))
        for k, title in enumerate(shown.columns)
    ]
    console.table(shown.title, columns, [[*map(cell_text, row)] for row in shown.rows])
    for file in files:
        console.result(file)


def _drawn(chosen: argparse.Namespace, items: set[str], console: Console) -> int:
    """Draw an item from the files of an earlier run and return the exit code.

    Raises:
        InputError: a word would be ignored, or the files are not those of the item and the case.
    """
    from studies.paper.items import module_of, read_sizes

    if len(items) != 1 or not items <= set(DRAWN):
        raise InputError(f"--from draws one item alone; add --only with one of {listed(DRAWN)}")
    beside = (("--dry-run", chosen.dry_run), ("--hyperparameters", chosen.hyperparameters))
    if others := [flag for flag, is_given in beside if is_given]:
        raise InputError(f"--from draws an item and does nothing else; remove {listed(others)}")
    (item,), source, paths = items, chosen.source, find_project(chosen.storage, chosen.tracking)
    module = module_of(item)
    origin, sizes = read_sizes(source, module.SIZE)
    if chosen.case != origin.case:
        raise InputError(f"{source} holds results of {origin.case}, not of {chosen.case}")
    command = f"studies reproduce-paper {origin.case} --only {item} --from {paths.show(source)}"
    shown: Shown = module.shown(origin, sizes)
    files = shown.write(paths.results(origin.label) / "paper" / item, command)
    names = [paths.show(file) for file in files]
    _show(shown, names, console)
    console.document({"command": "reproduce-paper", "label": origin.label, "files": names})
    return OK


def _plan(chosen: argparse.Namespace, console: Console) -> "Plan":
    """Put the plan together; its studies are those that the same words make with the other commands."""
    from studies.paper.plan import Plan, budget_for
    from studies.profile import load_profile

    asked = chosen.profile or PROFILE
    budget = budget_for(
        chosen.budget or "small",
        load_profile(asked),
        own_profile=asked != PROFILE,
        trials=chosen.trials,
        n_seeds=chosen.seeds,
    )

    words = [str(chosen.case)]
    for name in ("profile", "budget", "trials", "seeds", "seed", "hyperparameters"):
        value = getattr(chosen, name)
        words += [] if value is None else [f"--{name}", str(value)]
    typed = " ".join(words)

    def opener(*, window: tuple[float, float] | None = None, **changes: Any) -> "Task":
        given = {**vars(chosen), "profile": asked, "window": window, **changes}
        return open_task(chosen.command, given, console, f"studies reproduce-paper {typed}")

    return Plan(opener=opener, budget=budget, words=typed, trials=chosen.hyperparameters)
