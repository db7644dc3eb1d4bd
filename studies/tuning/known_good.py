"""Configurations that deserve to be tried before any search: the variant's, the profile's, a neighbour's."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from studies.tuning.coordinates import Params, nearest_params, same_settings
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord, trial_name

N_WARM_STARTS = 2


@dataclass(frozen=True)
class KnownGood:
    """A configuration with its source.

    Args:
        params: its hyperparameters in search coordinates.
        origin: where it comes from.
    """

    params: Params
    origin: str


@dataclass(frozen=True)
class Neighbour:
    """A finished study of the same label and another training-set size.

    Args:
        n_train: its training-set size.
        name: its name.
        records: its trials.
    """

    n_train: int
    name: str
    records: Sequence[TrialRecord]


def declared_tries(spec: StudySpec) -> list[KnownGood]:
    """Return the variant's configuration and those of the profile, each once, in the order they are tried."""
    settings = spec.base_config.to_dict()
    tries = [KnownGood(nearest_params(spec.search, settings), "default")]
    for place, wanted in enumerate(spec.enqueue):
        params = nearest_params(spec.search, settings | dict(wanted))
        if not any(same_settings(params, known.params) for known in tries):
            tries.append(KnownGood(params, f"enqueued {place}"))
    return tries


def neighbour_tries(spec: StudySpec, neighbours: Sequence[Neighbour]) -> list[KnownGood]:
    """Return the configurations of the study of the nearest size, the best first.

    Nearest means the least ratio of the sizes; of two that are equally near, the larger one, whose errors
    are less of an accident.
    """
    others = [one for one in neighbours if one.n_train != spec.n_train]
    if not others:
        return []
    nearest = min(others, key=lambda one: (abs(math.log(one.n_train / spec.n_train)), -one.n_train))
    complete = [record for record in nearest.records if record.state == "complete"]
    return [
        KnownGood(
            nearest_params(spec.search, record.config), f"neighbour {nearest.name}/{trial_name(record.index)}"
        )
        for record in sorted(complete, key=lambda record: (record.metrics["val/mae"], record.index))
    ]
