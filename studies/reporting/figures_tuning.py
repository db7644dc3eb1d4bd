"""Pictures of tuning: how the error of each trial fell, and what it came to over each hyperparameter."""

from collections.abc import Sequence

from studies.reporting.drawing import (
    BEST_SURROGATE,
    LOG,
    MUTED,
    SURROGATE,
    Axis,
    Figure,
    Panel,
    Series,
    size_colors,
)
from studies.results.trials import TrialView, TunedStudy
from studies.words.wording import axis_label, count, difference_unit

_DOT, _HOLLOW = {"filled": True, "opacity": 0.7}, {"filled": False, "opacity": 0.7}
_THIN = {"strokeWidth": 1.0, "opacity": 0.7}


def study_figure(study: TunedStudy) -> Figure | None:
    """Show the trials of one study: their learning curves, and their errors over each hyperparameter.

    Args:
        study: The study.

    Returns:
        The picture; None where no trial has reported an error.
    """
    learning = _learning(study)
    if learning is None:
        return None
    title = f"Trials of {study.spec.name}"
    return Figure(title, (learning, *_slices([study])), columns=2, shows_names=True)


def learning_figure(studies: Sequence[TunedStudy]) -> Figure | None:
    """Show how the validation error of each trial fell, a panel per training-set size.

    Args:
        studies: One per size.

    Returns:
        The picture; None where no trial has reported an error.
    """
    panels = tuple(filter(None, map(_learning, studies)))
    caption = "Validation errors at the epochs at which trials are compared; MLflow has those of all epochs."
    title = "Learning curves of the trials"
    return Figure(title, panels, columns=2, shows_names=True, caption=caption) if panels else None


def slices_figure(studies: Sequence[TunedStudy]) -> Figure | None:
    """Show the validation error of the trials over each hyperparameter.

    Args:
        studies: One per training-set size.

    Returns:
        The picture; None where no trial has both an error and a hyperparameter.
    """
    panels, title = _slices(studies), "Validation error over each hyperparameter"
    caption = "Hollow: pruned trials, at their last validation."
    return Figure(title, panels, columns=2, shows_names=True, caption=caption) if panels else None


def _learning(study: TunedStudy) -> Panel | None:
    best = study.best
    others = [one for one in study.trials if one.reported and one is not best]
    groups = [
        ("complete", SURROGATE, _THIN, [one for one in others if one.state == "complete"]),
        ("not complete", MUTED, _THIN, [one for one in others if one.state != "complete"]),
    ]
    if best is not None and best.reported:
        groups.append(("the best", BEST_SURROGATE, {"strokeWidth": 2.0}, [best]))
    series = []
    for name, color, style, trials in groups:
        points = [(epoch, value, one.number) for one in trials for epoch, value in one.reported.items()]
        if points:
            epochs, values, numbers = zip(*points, strict=True)
            series.append(Series(name, color, epochs, values, style=style, line=numbers))
    name = f"Validation MAE, n_train = {count(study.spec.n_train)}"
    return Panel(name, Axis("epoch"), Axis(_error(study), LOG), series) if series else None


def _slices(studies: Sequence[TunedStudy]) -> tuple[Panel, ...]:
    searched = {name: one for study in studies for name, one in study.spec.space.items()}
    colors = size_colors([study.spec.n_train for study in studies])
    panels = []
    for name, one in searched.items():
        is_of_names = one.kind == "categorical"
        series = []
        for study in studies:
            of_size = f"n_train {count(study.spec.n_train)}"
            for state, more, style in (("complete", "", _DOT), ("pruned", ", pruned", _HOLLOW)):
                points = _points(study.trials, name, state, is_of_names=is_of_names)
                if points:
                    x, y = zip(*points, strict=True)
                    color = colors[study.spec.n_train]
                    drawn = Series(of_size + more, color, x, y, "point", style, is_named=state == "complete")
                    series.append(drawn)
        if series:
            x_axis = Axis(name, LOG if one.log else {}, is_of_names=is_of_names)
            panels.append(Panel(name, x_axis, Axis(_error(studies[0]), LOG), series))
    return tuple(panels)


def _points(
    trials: Sequence[TrialView], name: str, state: str, *, is_of_names: bool
) -> list[tuple[object, float]]:
    found = [one for one in trials if one.state == state and one.value is not None and name in one.params]
    return [
        (str(one.params[name]) if is_of_names else one.params[name], one.value)
        for one in found
        if one.value is not None
    ]


def _error(study: TunedStudy) -> str:
    return axis_label("MAE", difference_unit(study.spec.output_unit))
