"""Which of many terms make up a derivative, and what a calibration says while it looks for them."""

import numpy as np
import pytest
from moving_for_tests import Moving, box, measured

from simulation.arrays import FloatArray
from studies.calibration.recorder import Progress
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.search.first_design import latin_hypercube
from studies.calibration.state_equations.equations import Structure
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.states import WatchedModel
from studies.calibration.state_equations.term_choice import chosen_terms
from studies.calibration.state_equations.terms import Term

HIDDEN = 1.0 + np.sin(np.linspace(0.0, 9.0, 60))[:, None]


def drawn(seed: int, n_terms: int) -> tuple[FloatArray, FloatArray, list[int]]:
    """Values of 40 terms in three rows, a target, and the terms that make it up."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((3, 120, 40)).cumsum(axis=1)
    # One is nearly another, one follows from two, one is not finite, one is always zero.
    values[..., 5] = values[..., 4] + 1e-6 * rng.standard_normal((3, 120))
    values[..., 7] = values[..., 8] - 2.0 * values[..., 9]
    values[1, 3, 11], values[..., 12] = np.inf, 0.0
    true = np.sort(rng.choice([4, *range(13, 40)], n_terms, replace=False)).tolist()
    coefficients = rng.uniform(0.5, 2.0, (3, 1, n_terms))
    return values, (values[..., true] * coefficients).sum(axis=2), true


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("n_terms", [1, 3, 9])
def test_the_terms_of_a_sum_are_found_among_many(seed: int, n_terms: int) -> None:
    values, target, true = drawn(seed, n_terms)
    chosen, left = chosen_terms([Term(k) for k in range(40)], values, target)
    assert sorted(chosen) == true
    assert left < 1e-20


def test_terms_that_are_nearly_one_are_distinguished() -> None:
    values, target, true = drawn(0, 3)
    target = target + 3e4 * (values[..., 5] - values[..., 4])
    chosen, left = chosen_terms([Term(k) for k in range(40)], values, target)
    assert set(chosen) == {4, 5, *true}
    assert left < 1e-16


def two_rooms(*, is_known: bool) -> Moving:
    """Two states, of which the second one's slope may be no sum of known terms."""

    def slope(k: FloatArray, x: FloatArray, y: FloatArray, u: float) -> list[FloatArray]:
        lost = k * y if is_known else np.tanh(k * y - 1.0)
        return [u - k * x, x - lost]

    return Moving(
        parameter_space=box(k=(0.5, 2.0)),
        units=("", "", ""),
        step_s=0.1,
        inputs=HIDDEN,
        slope=slope,
        start=lambda k: [0.0 * k + 1.0, 0.0 * k + 2.0],
    )


def test_what_lacked_terms_is_looked_at_first() -> None:
    model = two_rooms(is_known=False)
    watched = WatchedModel(model, model.signals)
    u = latin_hypercube(6, 1, np.random.default_rng(0))
    rows = watched.seen(watched.simulate(model.parameter_space.from_unit(u)).theta)
    looked_at = list[str]()
    first = Structure.of(model.signals, rows, think_of=looked_at.append)
    assert looked_at == ["der(x0)", "der(x1)"]
    assert first.lacking == "der(x1)"
    again = Structure.of(model.signals, rows, first.lacking, looked_at.append)
    assert looked_at == ["der(x0)", "der(x1)", "der(x1)"]
    assert (again.lacking, again.misfit) == (first.lacking, first.misfit)


def test_equations_do_not_depend_on_what_was_looked_at_first() -> None:
    model = two_rooms(is_known=True)
    watched = WatchedModel(model, model.signals)
    u = latin_hypercube(6, 1, np.random.default_rng(0))
    rows = watched.seen(watched.simulate(model.parameter_space.from_unit(u)).theta)
    one, other = Structure.of(model.signals, rows, "der(x1)"), Structure.of(model.signals, rows)
    assert [a.terms for a in one.sums] == [a.terms for a in other.sums]
    assert not one.lacking


def test_a_calibration_says_what_it_looks_at() -> None:
    model = two_rooms(is_known=False)
    problem, reports = measured(model, np.array([1.2]), 0.01), list[Progress]()
    ode = LearnedODE.of(problem)
    Adaptive(max_calls=40).minimize(problem, seed=0, learned_ode=ode, on_progress=reports.append)
    said = [one.thinks_of for one in reports]
    terms = {"terms of der(x0)", "terms of der(x1)"}
    assert {"", *terms, "functions that may be lower at other points"} <= {*said}
    # After a row, nothing is named; the number of calls never falls.
    assert (np.diff([one.n_done for one in reports]) >= 0).all()
    assert said[0] == ""
