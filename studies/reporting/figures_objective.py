"""Pictures of a user's objective: its value over the trials, or the Pareto set of several values."""

from collections.abc import Sequence
from itertools import combinations

from studies.reporting.drawing import BEST_SURROGATE, MUTED, SURROGATE, Axis, Figure, Panel, Series
from studies.results.objective import ObjectiveTrial, TunedObjective

_DOT, _STRONG = {"filled": True, "opacity": 0.6}, {"filled": True, "size": 70, "opacity": 1.0}


def objective_figure(found: TunedObjective) -> Figure | None:
    """Show the values of the complete trials: over their numbers, or of several values in pairs.

    Args:
        found: The study.

    Returns:
        The picture; None where no trial is complete.
    """
    complete = [one for one in found.trials if one.state == "complete"]
    if not complete:
        return None
    names = found.spec.values
    best = {one.number for one in found.best}
    groups = (
        ("not feasible", MUTED, _DOT, [one for one in complete if not one.is_feasible]),
        ("others", SURROGATE, _DOT, [one for one in complete if one.is_feasible and one.number not in best]),
        ("Pareto set" if len(names) > 1 else "the best", BEST_SURROGATE, _STRONG, [*found.best]),
    )

    def panel(x: str, y: str) -> Panel:
        series = [
            Series(name, color, _values(trials, x), _values(trials, y), "point", style)
            for name, color, style, trials in groups
            if trials
        ]
        return Panel(f"{y} over {x}", Axis(x), Axis(y), series)

    pairs = [*combinations(names, 2)] or [("trial", names[0])]
    return Figure(f"Trials of {found.spec.name}", tuple(panel(x, y) for x, y in pairs), min(len(pairs), 2))


def _values(trials: Sequence[ObjectiveTrial], name: str) -> list[float]:
    return [one.number if name == "trial" else one.values[name] for one in trials]
