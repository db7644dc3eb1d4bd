"""What a new study has from others: trials inside an edited search space, and the best of a smaller size."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from toy_study_for_tests import LABEL, SEARCH, essence, plain_study, runs_of, toy_study

from studies.paths import ProjectPaths
from studies.project import read_project, status_blocks, status_document
from studies.results.declaration import Declaration
from studies.tuning import attempts
from studies.tuning.carried import carried_trials
from studies.tuning.storage import open_storage
from studies.tuning.tune_studies import closed_studies, tune
from studies.tuning.worker import Worker

N = 6
SPEC = toy_study(16)
FLAT: dict[str, Any] = {"kind": "float", "low": 10.0, "high": 1000.0, "log": True}


@pytest.fixture(scope="module")
def finished(template: Path, tmp_path_factory: pytest.TempPathFactory) -> ProjectPaths:
    """A project with one study of six trials; to be read or copied."""
    root = tmp_path_factory.mktemp("finished") / "project"
    shutil.copytree(template, root)
    tune([SPEC], paths=ProjectPaths(root), n_trials=N, n_jobs=1)
    return ProjectPaths(root)


@pytest.fixture
def begun(finished: ProjectPaths, tmp_path: Path) -> ProjectPaths:
    """The same as a test may change it."""
    shutil.copytree(finished.root, tmp_path / "begun")
    return ProjectPaths(tmp_path / "begun")


def inside(paths: ProjectPaths, least: float) -> list[int]:
    trials = plain_study(paths, SPEC.name).get_trials()
    return [one.number for one in trials if one.params["beta"] >= least]


def test_trials_inside_an_edited_search_space_are_taken_along_and_not_trained_again(
    begun: ProjectPaths,
) -> None:
    expected, said = inside(begun, 10.0), list[str]()
    assert 0 < len(expected) < N
    edited = replace(SPEC, search={**SEARCH, "beta": FLAT})
    (found,) = tune([edited], paths=begun, n_trials=N, n_jobs=1, on_news=said.append)
    before, after = (plain_study(begun, name).get_trials() for name in (SPEC.name, edited.name))
    carried = [one for one in after if attempts.CARRIED in one.user_attrs]
    assert [one.user_attrs[attempts.CARRIED] for one in carried] == [
        f"trial {number} of {SPEC.name}" for number in expected
    ]
    for number, one in zip(expected, carried, strict=True):
        assert (one.params, one.value) == (before[number].params, before[number].value)
        assert one.intermediate_values == before[number].intermediate_values
        (run,) = runs_of(begun, LABEL, role="trial", study=SPEC.name, trial=str(number))
        assert run.info.run_id == one.user_attrs[attempts.RUN_ID]
        assert run.data.tags["carried_to"] == edited.name
    # They count: six trials, each of which was trained once.
    assert len(after) == N
    assert len(runs_of(begun, LABEL, role="trial")) == N + N - len(expected)
    assert f"carried over from before the search space was edited: {len(expected)} of {N}" in said[0]
    assert found.n_ended == found.n_planned == N + N - len(expected)
    assert found.of(edited.name).n_ended == N
    assert closed_studies([edited], begun, N) is not None
    assert closed_studies([SPEC], begun, N) is not None
    (size,) = status_document(read_project(begun))["studies"]
    assert (size["n_carried"], size["n_trials"]) == (len(expected), N + N - len(expected))
    assert "carried over" in str(status_blocks(read_project(begun)))


def test_the_best_surrogate_may_be_one_that_was_carried_over(begun: ProjectPaths) -> None:
    (before,) = tune([SPEC], paths=begun, n_trials=N, n_jobs=1)
    wider = replace(SPEC, search={**SEARCH, "beta": FLAT | {"low": 0.5, "high": 2000.0}})
    said = list[str]()
    (found,) = tune([wider], paths=begun, n_trials=N, n_jobs=1, on_news=said.append)
    assert found.best == before.best
    assert found.default == before.default
    assert found.model_uri == before.model_uri
    assert found.n_ended == N
    assert said == [
        f"n_train 16: carried over from before the search space was edited: {N} of {N} trials, which count "
        f"and are not trained again; --trials {2 * N} trains {N} more"
    ]
    # Carried over once more, each is still the trial that it first was.
    third = replace(SPEC, search={**SEARCH, "beta": FLAT | {"low": 0.5, "high": 3000.0}})
    assert len(list(carried_trials(open_storage(begun), third))) == N


def test_a_kill_while_trials_are_carried_over_loses_none_and_doubles_none(begun: ProjectPaths) -> None:
    edited = replace(SPEC, search={**SEARCH, "beta": FLAT})
    storage = open_storage(begun)
    carried = [*carried_trials(storage, edited)]
    assert len(carried) > 1
    attempts.make_study(storage, replace(edited, enqueue=()), n_trials=0, carried=carried[:1])
    study = plain_study(begun, edited.name)
    study.tell(study.ask(), 1.0)  # the default, which waits in it
    assert not carried[0].user_attrs.keys() - study.trials[0].user_attrs.keys()
    attempts.make_study(storage, edited, n_trials=0, carried=carried)
    assert len(study.get_trials()) == 2  # a study that has begun gets no more


@pytest.mark.parametrize(
    "changes",
    [
        {"settings": SPEC.settings | {"max_epochs": 11}},
        {"seed": 6},
        {"sampler": {"name": "RandomSampler"}},
        {"digests": SPEC.digests | {"test": "0" * 64}},
        {"digests": SPEC.digests | {"case": "0" * 64}},
        {"output_scales": (2.0,)},
        {"folds": 3},
        {"label": "other"},
        {"n_train": 17},
        {"is_baseline": True},
    ],
)
def test_nothing_is_taken_along_where_errors_or_seeds_differ(
    finished: ProjectPaths, changes: dict[str, Any]
) -> None:
    edited = replace(SPEC, search={**SEARCH, "beta": FLAT}, **changes)
    assert not list(carried_trials(open_storage(finished), edited))


def test_a_setting_that_is_fixed_or_searched_from_now_on_takes_its_trials_along(begun: ProjectPaths) -> None:
    one = plain_study(begun, SPEC.name).get_trials()[2]
    fixed = {name: declared for name, declared in SEARCH.items() if name != "n_latent"}
    settings = SPEC.settings | {"n_latent": one.params["n_latent"]}
    of_fixed = list(carried_trials(open_storage(begun), replace(SPEC, search=fixed, settings=settings)))
    assert {tuple(each.params) for each in of_fixed} == {("n_hidden", "beta")}
    assert one.value in [each.value for each in of_fixed]
    rate = {"kind": "float", "low": 1e-4, "high": 1e-1, "log": True}
    more = list(carried_trials(open_storage(begun), replace(SPEC, search={**SEARCH, "learning_rate": rate})))
    assert [each.params["learning_rate"] for each in more] == [SPEC.settings["learning_rate"]] * N


RATE: dict[str, Any] = {"kind": "float", "low": 1e-6, "high": 1e-1, "log": True}
SLOW = SPEC.settings | {"learning_rate": 1e-6}
SIZES = [
    toy_study(
        16, search={**SEARCH, "learning_rate": RATE}, settings=SLOW, enqueue=({"learning_rate": 0.01},)
    ),
    toy_study(24, search={**SEARCH, "learning_rate": RATE}, settings=SLOW),
]
"""Their default learns next to nothing, and the smaller one tries something better."""


def two_sizes(paths: ProjectPaths, **how: Any) -> list[list[tuple[Any, ...]]]:
    tune(SIZES, paths=paths, n_trials=4, **{"n_jobs": 1, **how})
    return [essence(plain_study(paths, spec.name)) for spec in SIZES]


@pytest.mark.slow
def test_the_last_trial_of_a_size_tries_the_best_of_the_next_smaller_one(project: ProjectPaths) -> None:
    small, large = two_sizes(project)
    assert len(small) == len(large) == 4
    best = min(small, key=lambda one: one[2])
    assert best[5] != "default"
    assert (large[-1][1], large[-1][5]) == (best[1], "smaller size")
    assert "smaller size" not in [one[5] for one in (*small, *large[:-1])]
    assert closed_studies(SIZES, project, 4) is not None


@pytest.mark.slow
def test_the_last_trial_depends_on_no_interruption_and_no_number_of_workers(
    project: ProjectPaths, tmp_path: Path
) -> None:
    other = ProjectPaths(tmp_path / "other")
    shutil.copytree(project.root, other.root)
    at_once = two_sizes(project, n_jobs=2)
    tune(SIZES, paths=other, n_trials=4, n_jobs=1, until_s=0.0)
    Worker(other, SIZES[1].name).run()  # as on another machine: the last trial waits
    assert len(plain_study(other, SIZES[1].name).trials) == 3
    Worker(other, SIZES[0].name).run()
    assert two_sizes(other) == at_once


@pytest.mark.slow
def test_a_configuration_that_was_tried_is_not_tried_again(project: ProjectPaths) -> None:
    fixed: dict[str, dict[str, Any]] = {"beta": {"kind": "categorical", "choices": [10.0]}}
    specs: list[Declaration] = [toy_study(n, search=fixed) for n in (16, 24)]
    tune(specs, paths=project, n_trials=2, n_jobs=1)
    trials = plain_study(project, specs[1].name).get_trials()
    assert [one.user_attrs.get("proposed_by") for one in trials] == ["default", None]
