"""What the items of the paper compute: small pieces with known answers."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from simulation.arrays import FloatArray
from simulation.design import spread_design
from simulation.errors import InputError
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.paper.catalog import ITEMS, chosen_items, item_module, with_needs
from studies.paper.fig5 import daily_course
from studies.paper.plan import BUDGETS, budget_for, trials_for
from studies.paper.published import TABLE_4
from studies.paper.result import ItemResult, finite, write_result
from studies.profile import load_profile
from studies.report.findings import quartiles
from studies.sensitivity import sobol_indices


@dataclass(frozen=True)
class Additive:
    """A sum of parameters with known weights, which change over time."""

    weights: FloatArray = field(default_factory=lambda: np.array([[1.0, 2.0, 0.0], [3.0, 1.0, 1.0]]))
    output_names: tuple[str, ...] = ("y",)

    @property
    def time(self) -> FloatArray:
        return 60.0 * np.arange(len(self.weights))

    @property
    def parameter_space(self) -> ParameterSpace:
        return ParameterSpace(tuple(Parameter(f"x{i}", 0.0, 1.0) for i in range(self.weights.shape[1])))

    def simulate(self, theta: FloatArray) -> Trajectories:
        return Trajectories.checked(
            theta,
            (theta @ self.weights.T)[:, :, None],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
            failures=[""] * len(theta),
        )


def test_the_indices_of_an_additive_model_sum_to_one_and_are_the_shares_of_its_variance() -> None:
    model = Additive()
    found = sobol_indices(model, n_base=2048, seed=3)
    shares = model.weights**2 / (model.weights**2).sum(axis=1, keepdims=True)
    assert found.first_order[:, 0] == pytest.approx(shares, abs=0.03)
    assert found.total_order[:, 0] == pytest.approx(shares, abs=0.03)
    assert found.first_order[:, 0].sum(axis=1) == pytest.approx(1.0, abs=0.04)


def test_the_course_of_a_day_forgets_the_start_and_finds_the_hour_of_the_extremes() -> None:
    time = 1800.0 * np.arange(10 * 48)
    hour = (time / 3600.0) % 24.0
    dip = 0.4 - 0.1 * (np.floor(hour) == 17) + 0.05 * (np.floor(hour) == 7)
    values = np.column_stack([dip + 5.0 * np.exp(-time / 7200.0), np.full(len(time), 0.2)])
    course = daily_course(time, values, begin_h=0.0)
    assert (course.lowest_h[0], course.highest_h[0]) == (17.0, 7.0)
    assert (course.lowest[0], course.highest[0]) == pytest.approx((0.3, 0.45))
    shifted = daily_course(time, values, begin_h=6.0)
    assert shifted.lowest_h[0] == 23.0


def test_a_spread_of_zero_is_one_point_and_the_unrestricted_parameters_keep_their_range() -> None:
    space = ParameterSpace(tuple(Parameter(name, 1.0, 3.0) for name in "abc"))
    middle = spread_design(space, 50, 0.0, 7)
    assert np.all(middle == 2.0)
    whole, some = spread_design(space, 50, 1.0, 7), spread_design(space, 50, 0.0, 7, columns=["a", "c"])
    assert np.all(some[:, [0, 2]] == 2.0)
    assert np.array_equal(some[:, 1], whole[:, 1])


def test_the_papers_own_table_adds_up_without_its_screening_check() -> None:
    assert [row.n_train + row.n_polish for row in TABLE_4] == [row.total for row in TABLE_4]


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 10])
def test_the_median_is_the_one_of_numpy(n: int) -> None:
    values = np.random.default_rng(n).random(n)
    lower, middle, upper = quartiles(values)
    assert middle == pytest.approx(np.median(values), rel=1e-15)
    assert lower == pytest.approx(np.quantile(values, 0.25, method="averaged_inverted_cdf"), rel=1e-15)
    assert upper == pytest.approx(np.quantile(values, 0.75, method="averaged_inverted_cdf"), rel=1e-15)


def test_a_metric_of_what_failed_is_left_out(tmp_path: Path) -> None:
    metrics = {"mse/n0032": None, "mse/n0064": 0.02, "median_calls/n0032": np.inf, "mae/n0032": np.nan}
    result = ItemResult("differs", "", {}, {}, (), (), {}, 0.0, {}, metrics=metrics)
    (file,) = write_result(tmp_path, result, {})
    assert json.loads(file.read_text(encoding="utf-8"))["metrics"] == {"mse/n0064": 0.02}


def test_what_is_not_finite_becomes_nothing_in_the_files() -> None:
    assert finite({"a": [float("inf"), 1.0], 3: float("nan")}) == {"a": [None, 1.0], "3": None}


def test_items_are_named_ordered_and_bring_what_they_need() -> None:
    assert [item.name for item in chosen_items(["fig9", "fig4"])] == ["fig4", "table4"]
    assert [item.name for item in with_needs(chosen_items(["fig7"]))] == ["fig5", "fig6", "fig7"]
    assert chosen_items(None) == ITEMS
    assert [item.name for item in with_needs(chosen_items(["seeds"]))] == ["fig6", "table4"]
    assert [item.name for item in with_needs(chosen_items(["fig9"]), frozenset({"fig6"}))] == ["table4"]
    with pytest.raises(InputError, match=r"--only fig1: there is no such item; there are fig4, ") as refused:
        chosen_items(["fig1"])
    named = str(refused.value).partition("there are ")[2]
    assert named == ", ".join(item.words for item in ITEMS)
    assert "table4 (or fig9, seeds)" in named
    for item in ITEMS:
        module = item_module(item)
        assert all(callable(getattr(module, word)) for word in ("inputs", "estimate_s", "run"))


def test_a_size_gets_the_trials_of_the_next_larger_one_that_is_named() -> None:
    trials = {256: 40, 4096: 8}
    assert [trials_for(trials, n) for n in (32, 256, 257, 4096, 8192)] == [40, 40, 8, 8, 8]


def test_a_profile_of_the_users_own_sets_sizes_and_trials() -> None:
    smoke = load_profile("smoke")
    budget = budget_for("full", smoke, own_profile=True, trials=None)
    assert (budget.n_train, trials_for(budget.trials, 16), budget.n_base) == ((16, 32), 2, 8)
    assert trials_for(budget_for("full", smoke, own_profile=True, trials=7).trials, 32) == 7
    assert budget_for("small", load_profile("thorough"), own_profile=False, trials=None) == BUDGETS["small"]
    with pytest.raises(InputError, match=r"--budget huge: there is no such budget; give small or full"):
        budget_for("huge", smoke, own_profile=False, trials=None)
