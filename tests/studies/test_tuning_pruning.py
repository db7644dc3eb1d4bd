"""Which running trials are stopped, and why."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from test_tuning_search import finished

from studies.tuning.pruning import Pruner, expected_end
from studies.tuning.search_space import propose
from studies.tuning.study_spec import StudySpec, TrialState
from studies.tuning.trial_record import TrialRecord

MakeSpec = Callable[..., StudySpec]
GOOD = {10: 4.0, 20: 2.0, 40: 1.0}
LATE = {10: 8.0, 20: 6.0, 40: 1.2}


def past(spec: StudySpec, *curves: dict[int, float], state: TrialState = "complete") -> list[TrialRecord]:
    """Make up finished trials with these errors at these epochs."""
    found = []
    for index, curve in enumerate(curves):
        record = finished(spec, propose(spec, 0, []), index, value=min(curve.values()), state=state)
        found.append(replace(record, reports={str(epoch): value for epoch, value in curve.items()}))
    return found


def stopped_at(spec: StudySpec, records: Sequence[TrialRecord], curve: dict[int, float]) -> int | None:
    """Return the epoch at which a trial is stopped."""
    pruner = Pruner(spec, records)
    return next((epoch for epoch, value in curve.items() if pruner.is_hopeless(epoch, value)), None)


def test_trial_that_cannot_catch_up_is_stopped(make_spec: MakeSpec) -> None:
    spec = make_spec()
    # From epoch 20 on ten trials halved their error. With the caution of ten trials it may fall by a part of
    # 0.5 * (1 + 1.5 / 10) = 0.575, so 2.35 is the most that can still become 1.0.
    records = past(spec, *[GOOD] * 10)
    assert stopped_at(spec, records, {10: 4.0, 20: 2.3}) is None
    assert stopped_at(spec, records, {10: 4.0, 20: 2.4}) == 20


def test_caution_falls_with_the_number_of_completed_trials(make_spec: MakeSpec) -> None:
    spec = make_spec()
    poor = {10: 4.0, 20: 2.6, 30: 2.6}
    assert stopped_at(spec, past(spec, GOOD), poor) is None
    assert stopped_at(spec, past(spec, *[GOOD] * 10), poor) == 20


def test_one_late_bloomer_spares_the_others(make_spec: MakeSpec) -> None:
    spec = make_spec()
    curve = {10: 7.0, 20: 4.0}
    assert stopped_at(spec, past(spec, *[GOOD] * 10), curve) == 20
    assert stopped_at(spec, past(spec, *[GOOD] * 9, LATE), curve) is None


def test_least_error_so_far_counts(make_spec: MakeSpec) -> None:
    spec = make_spec()
    assert stopped_at(spec, past(spec, *[GOOD] * 10), {10: 1.5, 20: 9.0}) is None


@pytest.mark.parametrize("pruner", ["catch-up", "median"])
def test_nothing_is_stopped_without_completed_trials(make_spec: MakeSpec, pruner: str) -> None:
    spec = make_spec(pruner=pruner)
    records = past(spec, GOOD, GOOD, GOOD, GOOD, GOOD, state="failed")
    assert stopped_at(spec, [], {10: 100.0, 20: 100.0}) is None
    assert stopped_at(spec, records, {10: 100.0, 20: 100.0}) is None


def test_median_is_optunas(make_spec: MakeSpec) -> None:
    spec = make_spec(pruner="median")
    records = past(spec, *({10: float(value), 40: float(value)} for value in (1, 2, 3, 4, 5)))
    assert stopped_at(spec, records, {10: 3.0}) is None
    assert stopped_at(spec, records, {10: 3.1}) == 10
    assert stopped_at(spec, records[:3], {10: 100.0}) is None


@pytest.mark.parametrize("change", [{"pruner": "none"}, {"objectives": ("val/mae", "val/p90")}])
def test_nothing_is_stopped_where_that_is_asked(make_spec: MakeSpec, change: dict[str, object]) -> None:
    spec = make_spec(**change)
    assert stopped_at(spec, past(spec, *[GOOD] * 10), {10: 100.0, 40: 100.0}) is None


def test_a_pruned_trial_was_heading_for_what_half_of_the_others_reach(make_spec: MakeSpec) -> None:
    spec = make_spec()
    completed = past(spec, {10: 4.0, 40: 1.0}, {10: 4.0, 40: 2.0}, {10: 4.0, 40: 3.0})
    (pruned,) = past(spec, {5: 7.0, 10: 6.0}, state="pruned")
    assert expected_end(pruned, completed) == 3.0
    assert expected_end(pruned, []) is None
    assert expected_end(replace(pruned, reports={}), completed) is None
