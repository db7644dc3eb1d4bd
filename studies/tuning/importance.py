"""How much each hyperparameter matters, asked of Optuna."""

from collections.abc import Mapping, Sequence
from typing import Any

import optuna

from studies.search_space import SearchSpace

MIN_TRIALS = 4


def importances(
    points: Sequence[Mapping[str, Any]], values: Sequence[float], space: SearchSpace
) -> dict[str, float]:
    """Return the part of the importance that each hyperparameter has, by Optuna's own evaluator.

    It is PED-ANOVA (Watanabe et al. 2023, arXiv:2304.10255). It compares where the best tenth of the points
    lies with where all lie. So only the order of the values counts.

    Args:
        points: hyperparameters by name.
        values: their errors, the least is the best; as many as points.
        space: the search space.

    Returns:
        Parts by name, which sum to 1, the largest first; empty with fewer than four points. [1]
    """
    if len(points) < MIN_TRIALS or not space:
        return {}
    study = optuna.create_study()
    for point, value in zip(points, values, strict=True):
        study.enqueue_trial(dict(point))
        trial = study.ask()
        for name, one in space.items():
            if name in point:
                one.suggest(trial, name)
        study.tell(trial, value)
    found = optuna.importance.get_param_importances(study)
    return dict(sorted(((name, float(part)) for name, part in found.items()), key=lambda pair: -pair[1]))
