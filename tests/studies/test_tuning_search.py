"""The search space and the choice of the next trial."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from optuna.distributions import FloatDistribution, IntDistribution

from pelsvae.config import VARIANTS
from simulation.errors import InputError
from simulation.parameters import ParameterSpace
from studies.profile import PROFILE_FOLDER, load_profile
from studies.search_ranges import SearchRanges
from studies.tuning.coordinates import distributions, nearest_params, to_settings
from studies.tuning.search_space import Proposal, derived_seed, proposal_of, propose
from studies.tuning.study_spec import StudySpec, TrialState
from studies.tuning.trial_record import TrialRecord

RANGES = SearchRanges(n_latent=(4, 128), n_hidden=(32, 256), beta=(1.0, 1000.0), learning_rate=(1e-4, 1e-2))
MakeSpec = Callable[..., StudySpec]


def finished(
    spec: StudySpec, proposal: Proposal, index: int, *, value: float, state: TrialState = "complete"
) -> TrialRecord:
    """Make up what a proposal may have become."""
    return TrialRecord(
        study=spec.name,
        n_train=spec.n_train,
        index=index,
        state=state,
        reason="made up",
        params=proposal.params,
        config=proposal.config.to_dict(),
        seed=proposal.seed,
        started_s=0.0,
        wall_s=1.0,
        digests=spec.digests,
        owner={},
        metrics={} if state == "failed" else {"val/mae": value, "val/p90": 2.0 * value},
    )


def history(spec: StudySpec, n: int) -> list[TrialRecord]:
    """Make up trials whose error depends on beta alone; every fourth is pruned."""
    past: list[TrialRecord] = []
    for index in range(n):
        proposal = propose(spec, index, past)
        state: TrialState = "pruned" if index % 4 == 3 else "complete"
        value = abs(proposal.params["beta"] - 30.0)
        past.append(finished(spec, proposal, index, value=value, state=state))
    return past


def test_widths_are_searched_as_powers_of_two_and_rates_logarithmically() -> None:
    space = distributions(RANGES)
    assert space["log2_n_latent"] == IntDistribution(2, 7)
    assert space["log2_n_hidden"] == IntDistribution(5, 8)
    assert space["beta"] == FloatDistribution(1.0, 1000.0, log=True)
    assert "n_layers" not in space


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("n_latent = [5, 7]", r"n_latent must hold a power of two, got \[5, 7\]"),
        ("n_layers = [1, 3]", r"n_layers.*greater than or equal to 2"),
        ("n_latent = [8, 4]", r"n_latent must be \[low, high\], got \[8, 4\]"),
    ],
)
def test_a_range_that_cannot_be_searched_is_told_before_anything_is_simulated(
    text: str, told: str, tmp_path: Path
) -> None:
    file = tmp_path / "own.toml"
    shipped = (PROFILE_FOLDER / "smoke.toml").read_text()
    file.write_text(shipped.replace("n_latent = [4, 8]", text))
    with pytest.raises(InputError, match=told):
        load_profile(str(file))


def test_widths_between_powers_of_two_are_allowed() -> None:
    assert distributions(SearchRanges(n_latent=(3, 9)))["log2_n_latent"] == IntDistribution(2, 3)


def test_settings_are_those_of_the_surrogate() -> None:
    settings = to_settings({"log2_n_latent": 5, "beta": 7.0})
    assert settings == {"n_latent": 32, "beta": 7.0}
    VARIANTS["paper"].replace(**settings)


def test_first_proposal_is_the_default(make_spec: MakeSpec) -> None:
    spec = make_spec(search=RANGES)
    first = propose(spec, 0, [])
    assert first.origin == "default"
    assert first.config == spec.base_config


@pytest.mark.parametrize(("n", "origin"), [(1, "random"), (4, "random"), (5, "gp"), (8, "gp")])
def test_proposal_depends_on_history_and_seed_alone(make_spec: MakeSpec, n: int, origin: str) -> None:
    spec = make_spec(search=RANGES)
    past = history(spec, n)
    once = propose(spec, n, past)
    assert once.origin == origin
    assert propose(spec, n, past) == once
    assert propose(replace(spec, seed=6), n, past).params != once.params


def test_trials_side_by_side_are_sent_to_different_places(make_spec: MakeSpec) -> None:
    spec = make_spec(search=RANGES)
    past = history(spec, 6)
    alone = propose(spec, 7, past)
    beside = propose(spec, 7, past, [alone.params])
    assert beside == propose(spec, 7, past, [alone.params])
    assert abs(np.log(beside.params["beta"] / alone.params["beta"])) > 1e-3


def test_interrupted_trial_is_proposed_again_as_it_was(make_spec: MakeSpec) -> None:
    spec = make_spec(search=RANGES)
    past = history(spec, 3)
    lost = propose(spec, 3, past)
    assert proposal_of(spec, 3, lost.params, origin=lost.origin) == lost


@given(
    n_latent=st.integers(1, 1000),
    n_hidden=st.integers(1, 1000),
    beta=st.floats(1e-6, 1e6),
    learning_rate=st.floats(1e-9, 1.0),
)
def test_nearest_params_lie_in_the_ranges(
    n_latent: int, n_hidden: int, beta: float, learning_rate: float
) -> None:
    settings: dict[str, Any] = {"n_latent": n_latent, "n_hidden": n_hidden}
    settings |= {"beta": beta, "learning_rate": learning_rate}
    params = nearest_params(RANGES, settings)
    for name, distribution in distributions(RANGES).items():
        assert distribution._contains(distribution.to_internal_repr(params[name]))


@given(st.integers(0, 2**31), st.integers(0, 1000))
def test_derived_seeds_are_32_bit_and_differ_by_use(seed: int, index: int) -> None:
    assert 0 <= derived_seed(seed, index, 0) < 2**32
    assert derived_seed(seed, index, 0) != derived_seed(seed, index, 1)


def _all_linear(space: ParameterSpace) -> ParameterSpace:
    return ParameterSpace(tuple(replace(parameter, scale="linear") for parameter in space.parameters))


def test_study_digest_covers_what_decides_and_nothing_else(make_spec: Any) -> None:
    spec: StudySpec = make_spec()
    assert (
        make_spec(note="other", label="other", overrides={**spec.overrides, "device": "auto"}).digest
        == spec.digest
    )
    changes: list[dict[str, Any]] = [
        {"case_digest": "d" * 64},
        {"train_digest": "d" * 64},
        {"validation_digest": "d" * 64},
        {"test_digest": "d" * 64},
        {"parameter_space": _all_linear(spec.parameter_space)},
        {"variant": "paper"},
        {"overrides": {**spec.overrides, "max_epochs": 21}},
        {"search": SearchRanges()},
        {"seed": 6},
        {"n_train": 17},
        {"pruner": "median"},
        {"objectives": ("val/mae", "val/p90")},
        {"enqueue": ({"beta": 2.0},)},
        {"warm_start": True},
    ]
    digests = {make_spec(**change).digest for change in changes}
    assert len(digests | {spec.digest}) == len(changes) + 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"variant": "best"}, "no variant 'best'; choose among"),
        ({"overrides": {"n_epochs": 3}}, "training settings of toy-small: unknown surrogate settings"),
        ({"overrides": {"patience": 0}}, "training settings of toy-small: patience = 0"),
    ],
)
def test_impossible_settings_are_one_line_before_any_work(
    make_spec: Any, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        _ = make_spec(**change).base_config


def test_too_few_training_rows_are_one_line(make_spec: Any) -> None:
    with pytest.raises(
        InputError, match=r"train.npz has 32 rows, n_train is 33; simulate more or ask for less"
    ):
        make_spec(n_train=33)
