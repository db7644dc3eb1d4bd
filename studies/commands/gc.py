"""`studies gc`: remove what nothing refers to."""

import argparse

from studies.commands.study import FAILED, OK
from studies.console import Console
from studies.paths import find_project

HELP = "show what nothing refers to and how much it takes, ask, remove"
MORE = """\
what happens: lists by kind, with sizes, and asks before anything goes:
  superseded studies (by newer data or settings), and those whose case or profile is gone, from everywhere
  weights of trials that are not their study's best; models that are neither champion nor previous
  runs in MLflow's bin, runs without records, files of runs that are no more
  sets of rows that no stage names, reports of nothing, copies kept aside, scratch of dead processes
  with --simulations: simulated rows that no set names (they are expensive; usually they stay)
What a running process works on is left alone. Interrupted at any moment, what is left is whole.

examples:
  studies gc --dry-run                     only look
  studies gc                               look, be asked
  studies gc --older-than 30d --yes        for a nightly job
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "--older-than", default="0d", metavar="AGE", help="only what is unchanged since, e.g. 30d, 12h"
    )
    command.add_argument("--simulations", action="store_true", help="also simulated rows that no set names")
    command.add_argument("--dry-run", action="store_true", help="only show what would go")
    command.add_argument("--yes", action="store_true", help="do not ask")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.keeping.collection import blocks_of, find_unused, is_agreed, remove
    from studies.keeping.wording import age, readable

    paths, age_s = find_project(chosen.storage), age(chosen.older_than)
    found = find_unused(paths, console, age_s=age_s, with_simulations=chosen.simulations)
    console.show(blocks_of(found))
    document = {
        "command": "gc",
        "found": [one.to_dict() for one in found],
        "size": sum(one.size for one in found),
        "removed": 0,
        "kept": [],
    }
    if not found or chosen.dry_run:
        console.document(document)
        return OK
    if not chosen.yes and not is_agreed(console, found):
        console.result("Nothing was removed.")
        return OK
    answers = list(remove(console, found))
    kept = [(one, why_not) for one, why_not in answers if why_not]
    for one, why_not in kept:
        console.warn(f"kept: {one.name}: {why_not}")
    freed = sum(one.size for one, why_not in answers if not why_not)
    console.result(f"{len(answers) - len(kept)} removed, {readable(freed)} freed")
    console.document(
        {**document, "removed": len(answers) - len(kept), "kept": [one.to_dict() for one, _ in kept]}
    )
    return FAILED if kept else OK
