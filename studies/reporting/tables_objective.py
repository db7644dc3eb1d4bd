"""The tables of a user's objective: what its studies stand at, and their best trials."""

from collections.abc import Sequence

from studies.blocks import Block, Column, Table, number
from studies.results.objective import ObjectiveTrial, TunedObjective
from studies.words.console import format_seconds
from studies.words.wording import MISSING, count, setting, significant

MOST_ROWS = 20


def objectives_table(found: Sequence[TunedObjective]) -> Table:
    """Tabulate what studies of objectives stand at, one line each."""
    columns = [Column("study"), number("trials"), number("pruned", spare=5), number("failed", spare=4)]
    columns += [number("running", spare=6), Column("best"), number("to go", spare=3)]
    rows = []
    for one in found:
        to_go = one.to_go_s
        rows.append(
            [
                one.spec.name,
                f"{one.n_ended}/{max(one.n_planned, len(one.trials))}",
                *(one.count(state) for state in ("pruned", "failed", "running")),
                _best(one),
                MISSING if to_go is None else format_seconds(to_go) if to_go else "done",
            ]
        )
    return Table("Studies of objectives", columns, rows)


def best_blocks_of(found: TunedObjective, storage: str) -> list[Block]:
    """Return the best trials of a study, and how Optuna loads it.

    Args:
        found: the study.
        storage: Optuna's URL of the project.
    """
    shown = found.best[:MOST_ROWS]
    names = list(dict.fromkeys(name for one in shown for name in one.params))
    constraints = list(dict.fromkeys(name for one in shown for name in one.constraints))
    aims = zip(found.spec.values, found.spec.directions, strict=True)
    columns = [number("trial"), *(number(f"{name} ({aim.removesuffix('imize')}.)") for name, aim in aims)]
    columns += [*(number(name) for name in names), *(number(name, spare=1) for name in constraints)]
    rows = [
        [
            one.number,
            *(significant(one.values[name]) for name in found.spec.values),
            *(setting(one.params.get(name)) for name in names),
            *(significant(one.constraints.get(name)) for name in constraints),
        ]
        for one in shown
    ]
    is_several = len(found.spec.values) > 1
    of_all = f" of {count(found.n_ended, 'trial')}"
    title = f"{found.spec.label}: {f'Pareto set of {len(found.best)}' if is_several else 'best'}{of_all}"
    left = len(found.best) - len(shown)
    load = f'  optuna.load_study(study_name="{found.spec.name}", storage="{storage}")'
    return [
        Table(title, columns, rows),
        *([f"{count(left)} more in --json"] if left else []),
        *(
            [f"{count(n, 'trial')} failed; the first: {_reason(found)}"]
            if (n := found.count("failed"))
            else []
        ),
        "In Python:",
        load,
        "",
    ]


def _best(found: TunedObjective) -> str:
    if not found.best:
        return MISSING
    if len(found.spec.values) > 1:
        return f"{count(len(found.best), 'trial')} in the Pareto set of {', '.join(found.spec.values)}"
    ((name, value),) = found.best[0].values.items()
    return f"{name} {significant(value)}"


def _reason(found: TunedObjective) -> str:
    return next(map(_reason_of, (one for one in found.trials if one.state == "failed")), "")


def _reason_of(trial: ObjectiveTrial) -> str:
    return trial.reason or "its worker died"
