"""Repeat the tables and figures of the paper and compare them.

What happens: each table and figure of the paper is a stage of its own. The stages share simulations,
trainings and calibrations with the other commands. Finished items are skipped; an interrupted item goes on
where it stopped. Each item shows the value of the paper and whether both agree. The page is
mlruns/reports/<label>/paper/index.html. Numbers (JSON), tables (CSV, Markdown) and pictures (PNG) are in
mlruns/results/<label>/paper/<item>/ and in MLflow.

--budget small (default) takes about an hour on two cores, --budget full up to twelve. The full budget uses
the trainings of the small one. --profile takes sizes and trials of another profile, for example smoke as a
test, or paper for the networks as the paper describes them.

Fig. 7 and Table 4 train the best network of each size in Fig. 6 once more. --hyperparameters FOLDER takes
these from the trials of an earlier Fig. 6, so that nothing is tuned.

--from FOLDER draws Fig. 6, Fig. 7 or Table 4 from the files of an earlier run. Nothing is simulated or
trained, and the recording is not needed. A clone of the repository has such files in data/paper-results.
There --only fig6 without other options draws from them, unless it was made there. --budget makes it anew.

Examples:
  studies reproduce-paper --dry-run                         the plan and its duration
  studies reproduce-paper --only fig5 fig7
  studies reproduce-paper office-recorded --budget full     after studies import-recording
  studies reproduce-paper office-recorded --only fig6       in a clone: drawn from the committed trials
  studies reproduce-paper office-recorded --only fig6 --from data/paper-results/fig6
  studies reproduce-paper office-recorded --only table4 --hyperparameters data/paper-results/fig6
  studies reproduce-paper office-recorded --export data/paper-results/office-recorded.json
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from simulation.errors import InputError
from studies.commands import options, values
from studies.commands.study import OK, open_study
from studies.console import Column, Console, format_seconds

if TYPE_CHECKING:
    from studies.paper.plan import Plan
    from studies.stages.pipeline import Study


PROFILE = "thorough"
BUDGET = "small"


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    from studies.paper.catalog import ITEMS

    names = ", ".join(item.words for item in ITEMS)
    options.add_name(command)
    options.add_trials(command)
    command.add_argument("--only", nargs="+", metavar="ITEM", help=f"only these items: {names}")
    command.add_argument("--row", metavar="NAME", help="with --only table3: only this row")
    command.add_argument("--budget", metavar="NAME", help="small (default) or full")
    command.add_argument(
        "--profile", metavar="NAME", help=f"sizes and trials of another profile; default: {PROFILE}"
    )
    command.add_argument(
        "--seeds", type=values.whole(1, 1000), metavar="N", help="number of seeds of the robust statistics"
    )
    command.add_argument("--again", action="store_true", help="repeat the items from their finished stages")
    command.add_argument(
        "--export", type=Path, metavar="FILE", help="also write the numbers of all items to one JSON file"
    )
    command.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="FOLDER",
        help="with --only fig6, fig7 or table4: draw it from the files of an earlier run",
    )
    command.add_argument(
        "--hyperparameters",
        type=Path,
        metavar="FOLDER",
        help="with fig7 or table4: take the best trials of Fig. 6 from here instead of tuning",
    )
    options.add_simulation(command)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.paper.catalog import chosen_items, with_needs

    there = frozenset() if chosen.hyperparameters is None else frozenset({"fig6"})
    items = with_needs(chosen_items(chosen.only), there)
    _refuse_senseless(chosen)
    source = chosen.source or _committed(chosen, console)
    if source is not None:
        return _drawn(chosen, source, console)
    plan = _plan(chosen, console)
    from studies.paper.gather import build_page, export
    from studies.paper.run import estimates_s, run_item

    study = plan.study
    if chosen.row is not None:
        return _one_row(plan, chosen.row, console)
    items = tuple(item for item in items if item.is_about(study.case.name))
    costs = estimates_s(plan, items)
    console.table(
        f"{study.label}: {plan.budget.name} budget",
        [Column("item"), Column("what"), Column("about", True)],
        [[i.words, i.what, format_seconds(costs[i.name]) if costs[i.name] else "finished"] for i in items],
    )
    console.say(
        f"reproduce-paper: about {format_seconds(sum(costs.values()))} in all, less where stages are finished"
    )
    document = {
        "command": "reproduce-paper",
        "label": study.label,
        "budget": plan.budget.to_dict(),
        "estimated_s": {name: round(cost, 1) for name, cost in costs.items()},
    }
    if chosen.dry_run:
        console.document({**document, "dry_run": True})
        return OK
    outcomes = []
    for item in items:
        wanted = chosen.again and item in chosen_items(chosen.only)
        outcomes.append(run_item(plan, item, again=wanted))
        # After every item, so that an interruption leaves a page of what is there.
        build_page(plan)
    index = build_page(plan)
    if chosen.export is not None:
        export(study, chosen.export)
    console.table(
        f"{study.label}: beside the paper",
        [Column("item"), Column("agreement"), Column("model calls", True), Column("work", True)],
        [
            [o.stage.removeprefix("paper/"), o.summary["agreement"], f"{o.summary['n_calls']:,}",
             format_seconds(o.summary["work_s"])]
            for o in outcomes
        ],
    )  # fmt: skip
    console.result(f"Page: {index}")
    console.document(
        {
            **document,
            "page": study.paths.show(index),
            "stages": [outcome.to_dict(study.paths) for outcome in outcomes],
        }
    )
    return OK


def _refuse_senseless(chosen: argparse.Namespace) -> None:
    """Refuse words that do not go together.

    Raises:
        InputError: one of them would be ignored.
    """
    from studies.paper.catalog import DRAWN, chosen_items
    from studies.report.wording import listed

    if chosen.dry_run and chosen.export is not None:
        raise InputError("--dry-run writes nothing, but --export writes a file; remove one of them")
    flags = (("--export", chosen.export), ("--again", chosen.again), ("--dry-run", chosen.dry_run))
    if chosen.source is not None:
        items = chosen_items(chosen.only)
        if len(items) != 1 or items[0].name not in DRAWN:
            raise InputError(f"--from draws one item alone; add --only with one of {listed(DRAWN)}")
        beside_it = (*flags, ("--row", chosen.row), ("--hyperparameters", chosen.hyperparameters))
        others = [flag for flag, is_given in beside_it if is_given]
        if others:
            raise InputError(f"--from draws an item and does nothing else; remove {listed(others)}")
    if chosen.row is None:
        return
    beside = [flag for flag, is_given in flags if is_given]
    if {item.name for item in chosen_items(chosen.only or ["table3"])} != {"table3"}:
        beside.insert(0, f"--only {' '.join(chosen.only)}")
    if beside:
        raise InputError(f"--row computes one row of table3 and nothing else; remove {listed(beside)}")


def _committed(chosen: argparse.Namespace, console: Console) -> Path | None:
    """Return the project's committed files of the one item that was asked for, None where it is to be made.

    It is made where a word says how, where the files are of another case, or where it was made here before.
    """
    from studies.paper.catalog import DRAWN, chosen_items
    from studies.paper.size_files import first_origin
    from studies.paths import find_project

    items = chosen_items(chosen.only)
    how = ("budget", "profile", "trials", "seed", "seeds", "row", "export", "hyperparameters")
    is_plain = not (chosen.again or chosen.dry_run) and all(getattr(chosen, word) is None for word in how)
    if not is_plain or len(items) != 1 or items[0].name not in DRAWN:
        return None
    item, paths = items[0].name, find_project(chosen.storage)
    folder = paths.data / "paper-results" / item
    origin = first_origin(folder)
    if origin is None or origin.case != chosen.case:
        return None
    if (paths.results(origin.label) / "paper" / f"{item}.json").exists():
        return None
    console.say(f"{item}: drawn from {paths.show(folder)}, as none was made here; --budget makes it anew")
    return folder


def _drawn(chosen: argparse.Namespace, source: Path, console: Console) -> int:
    """Draw an item from the files of an earlier run and return the exit code."""
    from studies.paper.catalog import chosen_items, drawn_module
    from studies.paper.run import write_drawn
    from studies.paths import find_project

    (item,) = chosen_items(chosen.only)
    origin, result = drawn_module(item).drawn_from(source)
    if chosen.case != origin.case:
        raise InputError(f"{source} holds results of {origin.case}, not of {chosen.case}")
    paths = find_project(chosen.storage)
    command = f"studies reproduce-paper {origin.case} --only {item.name} --from {paths.show(source)}"
    files = write_drawn(paths, item, origin, result, command)
    console.result(f"{result.agreement}: {result.verdict}")
    for file in files:
        console.say(paths.show(file))
    console.document(
        {
            "command": "reproduce-paper",
            "label": origin.label,
            "agreement": result.agreement,
            "verdict": result.verdict,
            "files": [paths.show(file) for file in files],
        }
    )
    return OK


def _one_row(plan: "Plan", name: str, console: Console) -> int:
    """Compute one row of Table 3 and return the exit code."""
    from studies.paper.table3 import run_one
    from studies.report.wording import mse_text

    found = run_one(plan, name)
    paper = found["paper"] or {"n_calls": None, "mse": None}
    shown = [found["title"], found["n_calls"], mse_text(found["mse"]), format_seconds(found["wall_s"])]
    console.table(
        f"{plan.study.label}: {found['name']}",
        [Column("row"), *(Column(t, True) for t in ("calls", "MSE", "work", "paper's calls", "paper's MSE"))],
        [[*shown, paper["n_calls"], paper["mse"]]],
    )
    console.document({"command": "reproduce-paper", **found})
    return OK


def _plan(chosen: argparse.Namespace, console: Console) -> "Plan":
    """Put the plan together; its studies are those that the same words make with the other commands."""
    from studies.paper.plan import Plan, budget_for
    from studies.profile import load_profile

    asked = chosen.profile or PROFILE
    own_profile = asked != PROFILE
    budget = budget_for(
        chosen.budget or BUDGET,
        load_profile(asked),
        own_profile=own_profile,
        trials=chosen.trials,
        n_seeds=chosen.seeds,
    )
    seed = chosen.seed

    def opener(
        *,
        case: str | None = None,
        window: tuple[float, float] | None = None,
        seed: int | None = seed,
        profile: str | None = None,
        n_train: tuple[int, ...],
        trials: int,
    ) -> "Study":
        words = vars(chosen) | {
            "case": case or chosen.case,
            "profile": profile or asked,
            "window": None if window is None else values.Window(*window),
            "seed": seed,
            "n_train": list(n_train),
            "trials": trials,
        }
        return open_study(argparse.Namespace(**words), console)

    words = [chosen.case]
    words += ["--profile", asked] if own_profile else []
    words += ["--budget", chosen.budget] if chosen.budget not in (None, BUDGET) else []
    words += ["--trials", str(chosen.trials)] if chosen.trials is not None else []
    words += ["--seeds", str(chosen.seeds)] if chosen.seeds is not None else []
    words += ["--seed", str(seed)] if seed is not None else []
    if chosen.hyperparameters is not None:
        words += ["--hyperparameters", str(chosen.hyperparameters)]
    return Plan(opener=opener, budget=budget, words=" ".join(words), trials=chosen.hyperparameters)
