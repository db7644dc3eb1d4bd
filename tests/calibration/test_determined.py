"""What a search knows at its end of what the data determine, against differences of the model."""

import numpy as np
import pytest
from problems_for_tests import TRUE_RC, problem_on, product_problem, rc_problem
from toys_for_tests import ProductToy

from simulation.arrays import FloatArray
from studies.calibration.adaptive import Adaptive
from studies.calibration.differences import difference_rows
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.stages.calibrated_point import determined
from studies.uncertainty.identifiability import judged
from studies.uncertainty.noise import noise_of

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
    assert [bool(found.note(name)) for name in problem.space.names] == [is_product] * 2
    assert len(found.sentences) == 2 * is_product


def test_of_a_first_design_alone_nothing_is_said() -> None:
    problem = product_problem()
    found = Adaptive(max_calls=4).minimize(problem, seed=0)
    assert found.slopes is None
    # Nor of what fits to the last digit: it shows no noise.
    exact = {"y": problem.model.simulate(TRUE_RC[None]).y[0], "slopes": np.eye(2)}
    assert determined(("R", "C"), problem.measurement, None, **exact) is None
    assert determined(("R", "C"), problem.measurement, None, y=found.y, slopes=None) is None
