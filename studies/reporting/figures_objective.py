"""Pictures of a user's objective: its value over the trials, or the Pareto set of several values."""

from collections.abc import Mapping, Sequence
from itertools import combinations

from studies.reporting.drawing import BEST_SURROGATE, MUTED, SURROGATE, Axis, Figure, Panel, Series

_STYLES = {"not feasible": MUTED, "others": SURROGATE, "the best": BEST_SURROGATE}


def objective_figure(
    title: str, names: Sequence[str], groups: Mapping[str, Sequence[Sequence[float]]]
) -> Figure:
    """Show the values of complete trials: over their numbers, or of several values in pairs.

    Args:
        title: what the picture shows.
        names: of the numbers of a trial: "trial", and those of its values. Length 1 + m.
        groups: the numbers of each trial: of those that are "not feasible", of "others", of "the best".
    """

    def panel(x: int, y: int) -> Panel:
        series = [
            Series(name, _STYLES[name], *zip(*((row[x], row[y]) for row in rows), strict=True), mark="point")
            for name, rows in groups.items()
            if rows
        ]
        return Panel(f"{names[y]} over {names[x]}", Axis(names[x]), Axis(names[y]), series)

    pairs = [(0, 1)] if len(names) == 2 else [*combinations(range(1, len(names)), 2)]
    return Figure(title, tuple(panel(x, y) for x, y in pairs), columns=min(len(pairs), 2))
