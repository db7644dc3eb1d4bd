"""The tables of a user's objective: what its studies stand at, and their best trials."""

from collections.abc import Sequence

from studies.blocks import Block, Column, Table, number
from studies.results.objective import TunedObjective, values_of
from studies.words.wording import MISSING, count, setting, significant

MOST_ROWS = 20


def objectives_table(found: Sequence[TunedObjective]) -> Table:
    """Tabulate what studies of objectives stand at, one line each."""
    states = ("pruned", "failed", "running")
    columns = [Column("study"), number("trials"), *map(number, states), Column("best")]
    rows = [
        [one.spec.name, f"{one.n_ended}/{one.n_planned}", *map(one.count, states), _best(one)]
        for one in found
    ]
    return Table("Studies of objectives", columns, rows)


def best_blocks_of(found: TunedObjective, storage: str) -> list[Block]:
    """Return the best trials of a study, and how Optuna loads it.

    Args:
        found: the study.
        storage: Optuna's URL of the project.
    """
    spec, shown = found.spec, [found.row(one) for one in found.best[:MOST_ROWS]]
    names = {key: [*dict.fromkeys(n for one in shown for n in one[key])] for key in ("params", "constraints")}
    aims = [f"{name} ({'max' if name in spec.maximize else 'min'}.)" for name in spec.values]
    columns = map(number, ("trial", *aims, *names["params"], *names["constraints"]))
    rows = [
        [
            one["trial"],
            *map(significant, one["values"].values()),
            *(setting(one[key].get(name)) for key in names for name in names[key]),
        ]
        for one in shown
    ]
    which = "best" if len(spec.values) == 1 else f"Pareto set of {count(len(found.best))}"
    table = Table(f"{spec.label}: {which} of {count(found.n_ended, 'trial')}", [*columns], rows)
    more = [f"{count(n)} more in --json"] if (n := len(found.best) - len(shown)) else []
    reason = next((found.row(one)["reason"] for one in found.trials if one.state.name == "FAIL"), "")
    failed = [f"{count(n, 'trial')} failed; the first: {reason}"] if (n := found.count("failed")) else []
    load = f'  optuna.load_study(study_name="{spec.name}", storage="{storage}")'
    return [table, *more, *failed, "In Python:", load, ""]


def _best(found: TunedObjective) -> str:
    names, n_best = found.spec.values, len(found.best)
    if len(names) > 1 or not n_best:
        return f"{count(n_best, 'trial')} in the Pareto set of {', '.join(names)}" if n_best else MISSING
    return f"{names[0]} {significant(values_of(found.best[0])[0])}"
