"""What a search knows at its end of what the data determine, against differences of the model."""

from itertools import combinations

import numpy as np
import pytest
from moving_for_tests import Moving, box, measured, with_equations
from problems_for_tests import TRUE_RC, problem_on, product_problem, rc_problem
from toys_for_tests import ProductToy

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from studies.calibration.differences import difference_rows, difference_slopes
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult
from studies.calibration.uncertainty.assess import Assessment, assess, sampling_within
from studies.calibration.uncertainty.findings import compensations, knowledge
from studies.calibration.uncertainty.identifiability import Ridge, judged, judged_slopes
from studies.calibration.uncertainty.noise import noise_of
from studies.reporting.sentences import determined_sentences
from studies.stages.calibrated_point import determined

# Of standard deviations by slopes of a surrogate, whose rows lie up to a tenth of the range away.
SPREAD_RTOL = 0.1


def adaptive(problem: CalibrationProblem) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    found = Adaptive(max_calls=60).minimize(problem, seed=0)
    return found.u, found.y, found.slopes


def polished(problem: CalibrationProblem) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    found = LeastSquaresTRF().minimize(problem, np.array([0.7, 0.4]))
    return found.u, found.y, found.slopes


@pytest.mark.parametrize("search", [adaptive, polished])
@pytest.mark.parametrize("is_product", [False, True])
def test_a_search_knows_what_differences_would_show(search, is_product: bool) -> None:
    problem = problem_on(ProductToy(), TRUE_RC, noise=0.05) if is_product else rc_problem(noise=0.05)
    u, y, slopes = search(problem)
    found = determined(problem.space.names, problem.measurement, None, y=y, slopes=slopes)
    assert found is not None
    noise = noise_of("correlated", problem.measurement, y, len(u))
    around = problem.evaluate(difference_rows(u, 1e-4))
    truth = judged(problem.space.names, around, noise.raised, 1e-4)
    np.testing.assert_allclose(list(found.spread.values()), truth.spread, rtol=SPREAD_RTOL)
    assert found.open == (("R", "C") if is_product else ())
    assert [one.strength < -0.9 for one in found.pairs] == [True] * is_product
    assert [name in found.open for name in problem.space.names] == [is_product] * 2
    assert len(determined_sentences(found)) == 2 * is_product


def weather() -> FloatArray:
    time = 600.0 * np.arange(144)
    return np.column_stack([278.0 + 6.0 * np.sin(time / 9000.0), 288.0 + 3.0 * np.cos(time / 5000.0)])


# R1, R2 and C act through R1 C and R2 C; R and C through R C, beside a start that is determined.
RESISTANCES = box(R1=(0.5, 20.0), R2=(0.5, 20.0), C=(200.0, 20_000.0))
TWO_PRODUCTS = Moving(
    RESISTANCES,
    ("K", "K", "K"),
    600.0,
    weather(),
    lambda r1, r2, c, x, outside, ground: [(outside - x) / (r1 * c) + (ground - x) / (r2 * c)],
    lambda r1, r2, c: [294.0 + 0.0 * c],
)
ONE_PRODUCT = Moving(
    ParameterSpace((*RESISTANCES.parameters[1:], Parameter("TStart", 285.0, 300.0))),
    ("K", "K"),
    600.0,
    weather()[:, :1],
    lambda r, c, start, x, outside: [(outside - x) / (r * c)],
    lambda r, c, start: [start],
)
RIDGES = {
    "2R1C": (TWO_PRODUCTS, [3.0, 6.0, 2000.0], Ridge(("R1", "R2", "C"), 1), "two of these three; fix one"),
    "RC": (ONE_PRODUCT, [6.0, 2000.0, 294.0], Ridge(("R2", "C"), 1), "one of these two; fix one"),
}


N_JUDGED = 2  # seeds of which a sample is drawn, too


def judged_by_uncertainty(problem: CalibrationProblem, found: AdaptiveResult) -> Assessment:
    """Judge a calibrated point as `studies uncertainty` does."""
    space = problem.space
    noise = noise_of("correlated", problem.measurement, found.y, space.n_parameters)
    sampling = sampling_within(70, space.n_parameters)
    theta = space.from_unit(found.u)
    return assess(problem, theta, found.y, noise=noise, known=None, sampling=sampling, seed=0)


@pytest.mark.parametrize("name", RIDGES)
@pytest.mark.parametrize(
    ("has_equations", "seed"), [*((True, seed) for seed in range(10)), *((False, seed) for seed in range(3))]
)
def test_data_without_noise_do_not_determine_what_acts_through_products(
    name: str, has_equations: bool, seed: int
) -> None:
    model, truth, ridge, words = RIDGES[name]
    problem = measured(model, np.array(truth), 0.0, sensor=0.1)
    if has_equations:
        found, _ = with_equations(problem, seed=seed, max_calls=60)
    else:
        found = Adaptive(max_calls=60).minimize(problem, seed=seed)
    assert found.converged
    assert "of the sensor's uncertainty" in found.stop_reason
    said = determined(problem.space.names, problem.measurement, None, y=found.y, slopes=found.slopes)
    assert said is not None
    assert said.ridges == (ridge,)
    assert said.open == ridge.names
    named = {(one.first, one.second): one.strength > 0.0 for one in said.pairs}
    assert named == {pair: pair == ("R1", "R2") for pair in combinations(ridge.names, 2)}, (
        "resistances rise together as the capacity falls"
    )
    assert words in determined_sentences(said)[-1]
    if seed < N_JUDGED:
        assessed = judged_by_uncertainty(problem, found)
        assert assessed.noise.kind == "sensor"
        assert set(assessed.local.determined) == set(problem.space.names) - set(said.open)
        pairs = compensations(problem.space, assessed.sample.particles)
        assert {(one.first, one.second) for one in pairs} == set(named)
        assert all(one.known == ("ratio" if named[one.first, one.second] else "product") for one in pairs)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("sensor", "n_open"), [(1.0, 2), (5.0, 3)])
def test_calibration_and_uncertainty_agree_on_what_is_determined(
    sensor: float, n_open: int, seed: int
) -> None:
    """Noise of 1 K: a sensor of 5 K does not determine the start, however well the residuals fit."""
    problem = measured(ONE_PRODUCT, np.array([6.0, 2000.0, 294.0]), 1.0, sensor=sensor, seed=seed)
    found = Adaptive(max_calls=60).minimize(problem, seed=seed)
    said = determined(problem.space.names, problem.measurement, None, y=found.y, slopes=found.slopes)
    assert said is not None
    assert said.open == problem.space.names[:n_open]
    assessed = judged_by_uncertainty(problem, found)
    known = knowledge(problem.space, assessed.sample.particles, assessed.local.determined)
    assert tuple(name for name, what in known.items() if what != "determined") == said.open


@pytest.mark.parametrize("u", [[0.997, 0.2], [1.0, 0.0], [0.5, 0.004]])
@pytest.mark.parametrize("fails", [False, True])
def test_differences_beside_a_bound_take_no_bend_for_a_slope(u: list[float], fails: bool) -> None:
    """Along u1 + u2 a parabola has its bend, and no slope across: uneven steps had shown one."""
    rows = difference_rows(np.array(u), 0.01)
    assert rows.min() >= 0.0
    assert rows.max() <= 1.0
    along = rows.sum(axis=1, keepdims=True)
    residuals = np.concatenate([3.0 * along + 40.0 * along**2, rows], axis=1)
    if fails:
        # Of a line through the point and one row, the row that is left.
        residuals[1], residuals[4] = np.nan, np.nan
    slopes = difference_slopes(rows, residuals)
    expected = np.column_stack([np.full(2, 3.0 + 80.0 * along[0, 0]), np.eye(2)])
    np.testing.assert_allclose(slopes, expected, atol=1e-9 if not fails else 40.0 * 0.0201)


def test_a_budget_that_holds_no_differences_leaves_open_what_is_determined() -> None:
    problem = measured(TWO_PRODUCTS, np.array([3.0, 6.0, 2000.0]), 0.0, sensor=0.1)
    whole = Adaptive(max_calls=60).minimize(problem, seed=0)
    short = Adaptive(max_calls=whole.n_calls - 1).minimize(problem, seed=0)
    assert short.n_calls == whole.n_calls - 6
    assert short.converged
    assert short.slopes is None


def test_four_of_five_parameters_are_determined_where_one_direction_is_open() -> None:
    slopes = np.zeros((5, 6))
    for row in range(4):
        slopes[row, row : row + 2] = 1.0
    slopes[4, 5] = 1.0
    names = ("a", "b", "c", "d", "e", "other")
    (ridge,) = judged_slopes(names, 1e3 * slopes, 1.0).ridges
    assert ridge == Ridge(("a", "b", "c", "d", "e"), 1)
    # With one residual less there are two; what moves nothing is in none.
    found = judged_slopes(names, 1e3 * slopes[[0, 2, 3]], 1.0)
    assert found.ridges == (Ridge(("a", "b"), 1), Ridge(("c", "d", "e"), 1))
    assert found.determined == ()


def test_of_a_first_design_alone_nothing_is_said() -> None:
    problem = product_problem()
    found = Adaptive(max_calls=4).minimize(problem, seed=0)
    assert found.slopes is None
    assert determined(("R", "C"), problem.measurement, None, y=found.y, slopes=None) is None
