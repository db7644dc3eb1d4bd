"""What is tried before the search, what is never tried twice, and two errors at once."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_tuning_search import finished

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.profile import TuningBudget, load_profile
from studies.search_ranges import SearchRanges
from studies.tuning.coordinates import Params, all_points, identity, to_settings
from studies.tuning.front import pareto_front
from studies.tuning.known_good import Neighbour
from studies.tuning.search_space import SearchExhaustedError, propose
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord, best_record
from studies.tuning.trial_store import StudyEntry, open_trials
from studies.tuning.trial_worker import finished_neighbours

MakeSpec = Callable[..., StudySpec]
SIX = SearchRanges(n_latent=(4, 16), n_hidden=(32, 64), beta=(10.0, 10.0))
WIDE = SearchRanges(n_latent=(4, 128), n_hidden=(32, 256), beta=(1.0, 1000.0))
ENQUEUED = {"n_latent": 4, "n_hidden": 64, "beta": 50.0}


def run(spec: StudySpec, n: int, neighbours: Callable[[], Sequence[Neighbour]] = tuple) -> list[TrialRecord]:
    """Make up a study of n trials whose error grows with the hidden width."""
    records: list[TrialRecord] = []
    for index in range(n):
        proposal = propose(spec, index, records, neighbours=neighbours)
        record = finished(spec, proposal, index, value=float(proposal.config.n_hidden))
        records.append(replace(record, reason=proposal.origin))
    return records


def test_enqueued_settings_follow_the_default_and_each_is_tried_once(make_spec: MakeSpec) -> None:
    default = {"n_latent": 32, "n_hidden": 256}
    spec = make_spec(search=WIDE, enqueue=(default, ENQUEUED, ENQUEUED, {"beta": 500.0}))
    records = run(spec, 4)
    assert [record.reason for record in records] == ["default", "enqueued 1", "enqueued 3", "random"]
    assert to_settings(records[1].params) == ENQUEUED
    assert to_settings(records[2].params) == {**default, "beta": 500.0}


def test_neighbours_best_are_tried_after_the_default(make_spec: MakeSpec) -> None:
    far, near, same = make_spec(search=WIDE, n_train=4), make_spec(search=WIDE, n_train=8), make_spec()
    found = [Neighbour(one.n_train, one.name, run(replace(one, seed=9), 6)) for one in (far, near, same)]
    spec = make_spec(search=WIDE, warm_start=True)
    warm = run(spec, 4, lambda: found)
    # The neighbour began with the default as well, so its best two others are tried.
    best = sorted(found[1].records[1:], key=lambda record: (record.metrics["val/mae"], record.index))
    assert [record.params for record in warm[1:3]] == [record.params for record in best[:2]]
    assert warm[1].reason == f"neighbour {near.name}/t{best[0].index:03d}"
    assert warm[3].reason == "random"
    cold = run(spec, 4)
    assert [record.reason for record in cold] == ["default", "random", "random", "random"]


def test_only_finished_studies_of_the_same_label_and_case_are_neighbours(
    make_spec: MakeSpec, project: ProjectPaths
) -> None:
    changes: list[tuple[int, dict[str, Any]]] = [
        (2, {"n_train": 8}),
        (2, {"n_train": 32, "label": "other"}),
        (2, {"n_train": 32, "case_digest": "e" * 64}),
        (3, {"n_train": 32}),  # two of three trials are finished
        (2, {"n_train": 16, "seed": 9}),
    ]
    for n_planned, change in changes:
        other = make_spec(search=WIDE, **change)
        store = open_trials(project, other)
        store.describe(StudyEntry.of(other, n_planned=n_planned, created_s=1.0))
        for record in run(other, 2):
            store.write(record, {})
    (neighbour,) = finished_neighbours(project, make_spec(n_train=16))
    assert (neighbour.n_train, len(neighbour.records)) == (8, 2)


def test_neighbours_are_not_asked_without_need(make_spec: MakeSpec) -> None:
    def fail() -> Sequence[Neighbour]:
        raise AssertionError

    run(make_spec(search=WIDE), 4, fail)


def test_no_configuration_is_trained_twice_until_none_is_left(make_spec: MakeSpec) -> None:
    spec = make_spec(search=SIX)
    assert SIX.n_configurations == 6
    records = run(spec, 6)
    tried = {identity(record.params) for record in records}
    assert tried == {identity(point) for point in all_points(SIX) or ()}
    assert run(spec, 6) == records
    assert any("repeated a trial" in record.reason for record in records)
    with pytest.raises(SearchExhaustedError, match=r"has been tried \(6\); widen \[tuning.search\]"):
        propose(spec, 6, records)


def test_configurations_that_run_beside_count_as_tried(make_spec: MakeSpec) -> None:
    spec = make_spec(search=SIX)
    records = run(spec, 3)
    pending: list[Params] = []
    for index in (3, 4, 5):
        pending.append(propose(spec, index, records, pending).params)
    tried = {identity(params) for params in [*(record.params for record in records), *pending]}
    assert len(tried) == 6
    with pytest.raises(SearchExhaustedError):
        propose(spec, 6, records, pending)


def test_two_errors_are_searched_together(make_spec: MakeSpec) -> None:
    spec = make_spec(search=WIDE, objectives=("val/mae", "val/p90"))
    records = run(spec, 7)
    assert [record.reason for record in records[4:]] == ["random", "tpe", "tpe"]
    # A failed trial has no errors, and is told to the search as a bad one.
    lost = [*records[:6], replace(records[6], state="failed", metrics={})]
    assert propose(spec, 7, lost).origin == "tpe"


@pytest.mark.parametrize(
    ("changes", "n"),
    [
        ({}, 6),
        ({"n_latent": (5, 17)}, 4),
        ({"n_layers": (2, 4)}, 18),
        ({"learning_rate": (1e-3, 1e-3)}, 6),
        ({"learning_rate": (1e-3, 1e-2)}, None),
        ({"beta": (1.0, 10.0)}, None),
    ],
)
def test_configurations_are_counted_as_they_are_listed(changes: dict[str, Any], n: int | None) -> None:
    ranges = replace(SIX, **changes)
    points = all_points(ranges)
    assert ranges.n_configurations == n == (None if points is None else len(points))
    assert TuningBudget(n_trials=8, variant="refined", search=ranges).n_different_trials == min(8, n or 8)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('objectives = ["val/p90"]', r"objectives must be \[.val/mae.\] or"),
        ("enqueue = [{n_scales = 9}]", r"enqueue\[0\].n_scales = 9 lies outside its range, 1 to 4"),
        (
            "search = {n_hidden = [8, 16]}",
            r'search.n_hidden does nothing in variant "gaussian-process", which has n_scales, degree',
        ),
        (
            'variant = "refined"\nsearch = {degree = [1, 2]}',
            r'search.degree does nothing in variant "refined"',
        ),
        (
            'variant = "refined"\nenqueue = [{n_latent = 48}]',
            r"enqueue\[0\].n_latent = 48 is no power of two",
        ),
        (
            'variant = "refined"\nenqueue = [{n_latent = 512}]',
            r"enqueue\[0\].n_latent = 512 lies outside its range, 8 to 128",
        ),
        (
            'variant = "refined"\nenqueue = [{beta = 2.0}, {learning_rate = 0.1}]',
            r"enqueue\[1\].learning_rate = 0.1 is not searched",
        ),
    ],
)
def test_impossible_wishes_are_one_line(tmp_path: Path, line: str, message: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'name = "mine"\n[data]\nn_train = [8]\n[tuning]\nn_trials = 2\n{line}\n')
    with pytest.raises(InputError, match=message):
        load_profile(str(file))


def test_front_holds_what_no_other_trial_beats_in_both_errors(make_spec: MakeSpec) -> None:
    spec = make_spec()
    points = [(3.0, 1.0), (1.0, 3.0), (2.0, 2.0), (2.0, 2.0), (2.5, 2.0), (1.0, 4.0)]
    records = [
        replace(
            finished(spec, propose(spec, 0, []), index, value=mae),
            metrics={"val/mae": mae, "val/p90": p90},
        )
        for index, (mae, p90) in enumerate(points)
    ]
    records.append(finished(spec, propose(spec, 0, []), 6, value=0.1, state="pruned"))
    front = pareto_front(records, ("val/mae", "val/p90"))
    assert [record.index for record in front] == [1, 2, 0]
    assert front[0] is best_record(records)
