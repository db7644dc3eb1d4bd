"""The best surrogate of each training-set size as a table: in the terminal and on MLflow's page."""

from collections.abc import Sequence

from studies.console import Column, Table
from studies.report.records_tuning import TunedSize
from studies.report.wording import MISSING, percent, setting, significant

_SPARE = {"PCA+GP MAE": 1, "trial": 2, "PCA+GP P90": 3, "trials": 4, "MAE val": 5}
"""Columns that a narrow terminal can do without, the last one first."""


def error(errors: TunedSize | None, name: str) -> str:
    """Return an error of the best trial as it is shown."""
    value = None if errors is None else errors.metrics.get(name)
    return MISSING if value is None else significant(value)


def leaderboard(sizes: Sequence[TunedSize], title: str) -> Table:
    """Tabulate the best surrogates, one row for each size that has one.

    Args:
        sizes: what tuning came to.
        title: above the table; the errors' unit is added.
    """
    names, found = _searched(sizes), [one for one in sizes if one.trial is not None]
    outputs = [n for n in dict.fromkeys(n for one in found for n in one.metrics) if n.startswith("test/mae_")]
    errors = {"MAE": "test/mae", "P90": "test/p90", "MAE val": "val/mae"}
    errors |= {name.removeprefix("test/").replace("_", " ", 1): name for name in outputs}
    headings = ["n_train", *names, *errors, "vs default", "PCA+GP MAE", "PCA+GP P90", "trials", "trial"]
    beside = ("test/mae", "test/p90")
    rows = [
        [
            one.n_train,
            *(setting(one.params.get(name)) for name in names),
            *(significant(one.metrics[name]) for name in errors.values()),
            MISSING if one.gain is None else "±0 %" if one.gain <= 0.0 else percent(-one.gain),
            *(significant(one.baseline[name]) if one.baseline else MISSING for name in beside),
            one.n_trials,
            one.trial,
        ]
        for one in found
    ]
    unit = f" in {found[0].unit}" if found and found[0].unit else ""
    columns = [Column(heading, True, _SPARE.get(heading, 0)) for heading in headings]
    return Table(f"{title}, errors on the test set{unit}", columns, rows, is_dense=True)


def leaderboard_note(sizes: Sequence[TunedSize], note: str) -> str:
    """Return the table as Markdown for the head of a label's page in MLflow.

    Args:
        sizes: what tuning came to.
        note: stands below it.
    """
    table = leaderboard(sizes, "Best surrogate per training-set size")
    if not table.rows:
        return note
    # MLflow's page shows the first line alone until it is unfolded.
    names, best = _searched(sizes), [one for one in sizes if one.trial is not None]
    each = [
        f"{one.n_train}: {' / '.join(setting(one.params.get(name)) for name in names)} → "
        f"{error(one, 'test/mae')}, {error(one, 'test/p90')}"
        for one in best
    ]
    first = f"Best per n_train ({' / '.join(names)} → test MAE, P90 {best[0].unit}): {' · '.join(each)}"
    lines = [[column.title for column in table.columns], ["---:"] * len(table.columns), *table.rows]
    drawn = "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in lines)
    return "\n\n".join(part for part in (first, drawn, note) if part)


def _searched(sizes: Sequence[TunedSize]) -> list[str]:
    return list(dict.fromkeys(name for one in sizes for name in one.params))
