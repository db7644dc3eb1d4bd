"""The search space as a profile declares it: every kind of hyperparameter, and faults in one line."""

from pathlib import Path
from typing import Any

import optuna
import pytest
from toy_study_for_tests import SEARCH, plain_study, toy_study

from pelsvae.config import VARIANTS
from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.profile import load_profile
from studies.search_space import (
    NETWORK_SPACE,
    PCA_GP_SPACE,
    SearchParameter,
    SearchSpace,
    default_point,
    space_of,
    suggested,
)
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker

ALL_KINDS: dict[str, dict[str, Any]] = {
    "n_latent": {"kind": "int", "low": 4, "high": 32, "log": True},
    "n_layers": {"kind": "int", "low": 2, "high": 4},
    "batch_size": {"kind": "int", "low": 8, "high": 32, "step": 8},
    "beta": {"kind": "float", "low": 1.0, "high": 100.0, "log": True},
    "optimizer": {"kind": "categorical", "choices": ["adam", "adamw"]},
    "weight_decay": {"kind": "float", "low": 0.0, "high": 0.5, "step": 0.1, "when": {"optimizer": "adamw"}},
    "patience": {"kind": "int", "low": 2, "high": 3, "when": {"n_layers": [3, 4], "optimizer": "adam"}},
}
PROFILE = """\
schema = 1
name = "mine"
[data]
n_train = [16]
[tuning]
n_trials = 3
{more}
[tuning.search]
{search}
"""


def space(declared: dict[str, dict[str, Any]]) -> SearchSpace:
    return {name: SearchParameter(**one) for name, one in declared.items()}


def test_conditional_hyperparameters_are_asked_where_they_have_an_effect() -> None:
    base = VARIANTS["refined"].replace(weight_decay=0.0, optimizer="adam")
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    asked = []
    for _ in range(40):
        chosen = suggested(study.ask(), space(ALL_KINDS), base)
        base.replace(**chosen)  # every draw can be trained
        asked.append(chosen)
        assert ("weight_decay" in chosen) == (chosen["optimizer"] == "adamw")
        assert ("patience" in chosen) == (chosen["optimizer"] == "adam" and chosen["n_layers"] > 2)
        assert chosen["batch_size"] in (8, 16, 24, 32)
        assert chosen["n_latent"] in range(4, 33)
    assert {len(chosen) for chosen in asked} == {5, 6}


def test_a_study_tunes_every_kind_of_hyperparameter(project: ProjectPaths) -> None:
    settings = toy_study().settings | {"max_epochs": 2, "optimizer": "adam", "weight_decay": 0.0}
    spec = toy_study(search=ALL_KINDS, settings=settings)
    tune([spec], paths=project, n_trials=8, n_jobs=1, until_s=0.0)
    Worker(project, spec.name).run()
    trials = plain_study(project, spec.name).get_trials()
    assert [trial.state.name for trial in trials] == ["COMPLETE"] * 8
    assert {trial.params["optimizer"] for trial in trials} == {"adam", "adamw"}
    assert all(("weight_decay" in t.params) == (t.params["optimizer"] == "adamw") for t in trials)


@pytest.mark.parametrize("surrogate", ["refined", "paper", "pca-gp"])
def test_the_default_lies_inside_the_usual_space(surrogate: str) -> None:
    usual, base = space_of(surrogate, None), VARIANTS[surrogate]
    assert usual is (PCA_GP_SPACE if surrogate == "pca-gp" else NETWORK_SPACE)
    point = default_point(usual, base)
    assert set(point) == set(usual)
    for name, value in point.items():
        assert usual[name].nearest(value) == value
        assert value == getattr(base, name)  # inside from the start, so that nothing is clipped


@pytest.mark.parametrize(
    ("search", "more", "message"),
    [
        ("", "n_trails = 2", "n_trails"),
        ("n_latent = [4, 8]", "", r"tuning\.search\.n_latent"),
        ("", "[sensitivity]\nn_base = 100", "sensitivity.*power of two"),
        ('n_trees = { kind = "int", low = 1, high = 2 }', "", "search.n_trees has no effect on surrogate"),
        (
            'n_layers = { kind = "int", low = 1, high = 2 }',
            "",
            "search.n_layers: n_layers = 1 must be at least",
        ),
        (
            'beta = { kind = "float", low = 1.0, high = 2.0, when = { n_latent = 8 } }\n'
            'n_latent = { kind = "int", low = 4, high = 8 }',
            "",
            "search.beta.when names n_latent; declare n_latent before beta",
        ),
        (
            'beta = { kind = "float", low = 1.0, high = 2.0 }',
            "enqueue = [{ beta = 3.0 }]",
            r"enqueue\[0\].beta = 3.0 is no value of search.beta",
        ),
    ],
)
def test_a_wrong_profile_is_reported_in_one_line(
    tmp_path: Path, search: str, more: str, message: str
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(PROFILE.format(search=search, more=more))
    with pytest.raises(InputError, match=message) as reported:
        load_profile(str(file))
    assert "\n" not in str(reported.value)
    assert str(reported.value).startswith(str(file))


def test_the_configurations_of_a_profile_come_right_after_the_default(project: ProjectPaths) -> None:
    enqueue = ({"beta": 3.0}, {"n_latent": 2, "n_hidden": 9})
    spec = toy_study(enqueue=enqueue)
    tune([spec], paths=project, n_trials=3, n_jobs=1, until_s=0.0)
    tune([spec], paths=project, n_trials=3, n_jobs=1, until_s=0.0)  # enqueued once
    Worker(project, spec.name).run()
    trials = plain_study(project, spec.name).get_trials()
    default = default_point(space(SEARCH), spec.base_config)
    assert [trial.params for trial in trials] == [default, default | enqueue[0], default | enqueue[1]]


def fixed_profile(tmp_path: Path, fixed: str, *, surrogate: str = "state-space") -> Path:
    search = "n_hidden = { kind = 'int', low = 8, high = 16 }\n"
    search += "decoder = { kind = 'categorical', choices = ['state-space', 'layers'] }"
    text = PROFILE.format(more=f'surrogate = "{surrogate}"', search=search) + f"[tuning.fixed]\n{fixed}\n"
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    return tmp_path / "mine.toml"


def test_a_fixed_setting_is_not_searched(tmp_path: Path) -> None:
    budget = load_profile(
        str(fixed_profile(tmp_path, "decoder = 'layers'\nbeta = 7.0\nn_latent = 16"))
    ).tuning
    assert set(budget.space) == {"n_hidden"}
    assert budget.fixed == {"decoder": "layers", "beta": 7.0, "n_latent": 16}


@pytest.mark.parametrize(
    ("fixed", "said"),
    [
        ("n_hiden = 8", "fixed.n_hiden has no effect on surrogate"),
        ("n_scales = 2", "fixed.n_scales has no effect on surrogate"),
        ("beta = 'ten'", "fixed: beta = 'ten' must be float"),
        ("decoder = 'trees'", "fixed: decoder = 'trees' must be one of"),
    ],
)
def test_a_fixed_setting_that_is_none_is_refused_in_one_line(tmp_path: Path, fixed: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_profile(str(fixed_profile(tmp_path, fixed)))
