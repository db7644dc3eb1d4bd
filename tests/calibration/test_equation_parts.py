"""The parts that learn state equations, each alone: rows, identification, belief, walks, and a learner."""

import numpy as np
import pytest
from moving_for_tests import Moving, box

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from studies.calibration.descent import Descents
from studies.calibration.problem import CalibrationProblem
from studies.calibration.state_equations.belief import MOST_FAILED, Belief, mismatch
from studies.calibration.state_equations.identification import Identification, LearntRows
from studies.calibration.state_equations.learner import EquationLearner
from studies.calibration.state_equations.states import WatchedModel

N_STEPS = 60


def cooling(*, kick: float = 0.0) -> Moving:
    """A body that loses heat to the outside, dT/dt = G (u - T) / C, and jumps where there is a kick."""
    outside = 5.0 + 5.0 * np.sin(0.3 * np.arange(N_STEPS))[:, None]
    return Moving(
        box(g=(0.5, 2.0), c=(4.0, 9.0)),
        ("K", "K"),
        0.5,
        outside,
        lambda g, c, x, u: [g * (u - x) / c],
        lambda g, c: [np.full_like(g, 20.0)],
        kick=kick,
    )


def learner_of(model: Moving) -> tuple[EquationLearner, CalibrationProblem]:
    watched = WatchedModel(model, model.signals)
    y = watched.simulate(model.parameter_space.from_unit(np.array([[0.3, 0.6]]))).y[0]
    problem = CalibrationProblem(watched, Measurement.on_grid(model.time, y, ("y0",), np.array([0.1])))
    return EquationLearner(model.signals, watched.seen, problem), problem


def design(n: int) -> FloatArray:
    return np.random.default_rng(0).random((n, 2))


def rows_of(model: Moving, u: FloatArray) -> LearntRows:
    watched = WatchedModel(model, model.signals)
    rows = LearntRows(model.signals, 2, 3)
    shown = watched.seen(watched.simulate(model.parameter_space.from_unit(u)).theta)
    for row in range(len(u)):
        one = slice(row, row + 1)
        rows.add(u[one], shown.take(one), np.full((1, 3), float(row)))
    return rows


def test_rows_come_back_in_their_order_with_what_states_did() -> None:
    model, u = cooling(), design(4)
    rows = rows_of(model, u)
    np.testing.assert_array_equal(rows.u, u)
    np.testing.assert_array_equal(rows.residuals[:, 0], [0.0, 1.0, 2.0, 3.0])
    expected = model.simulate(model.parameter_space.from_unit(u)).y
    np.testing.assert_array_equal(rows.states(model.signals).x, expected[..., 1:2])
    assert rows.hold(np.concatenate([u[2:], 1.0 - u[:1]])).tolist() == [True, True, False]


def test_identification_finds_the_equation_from_four_rows_and_says_why_not_from_three() -> None:
    model = cooling()
    known = Identification(model.signals, model.parameter_space)
    assert known.equations(rows_of(model, design(3))) is None
    assert known.why_not == "fewer than 4 simulations show what states did"
    equations = known.equations(rows_of(model, design(4)))
    assert equations is not None
    slope, _ = equations.structure.sums
    assert [(term.column, term.is_difference) for term in slope.terms] == [(1, True)]
    formula = equations.by_term[0][0].formula
    assert formula is not None
    assert formula.powers.tolist() == [[1, -1]]
    assert formula.amounts == pytest.approx([1.0])
    assert known.misfit < 1e-9


def test_a_row_that_follows_other_equations_is_named() -> None:
    model = cooling()
    known = Identification(model.signals, model.parameter_space)
    rows = rows_of(model, design(4))
    assert known.equations(rows) is not None
    shown = rows_of(cooling(), design(5)).states(model.signals)
    rows.add(design(5)[4:], shown.take(slice(4, 5))._replace(slope=shown.x[4:] ** 3), np.zeros((1, 3)))
    assert known.equations(rows) is None
    assert known.why_not == "not all simulations follow the same ones"


def test_belief_ends_with_a_mismatch_or_four_failures() -> None:
    assert Belief().is_sure
    assert Belief(mismatch=1e-2).is_kept
    assert not Belief(mismatch=1e-2).is_sure
    assert not Belief(mismatch=0.1).is_kept
    assert not Belief(n_failed=1, has_failed=True).is_sure
    assert Belief(n_failed=MOST_FAILED - 1).is_sure
    assert not Belief(n_failed=MOST_FAILED).is_kept


def test_mismatch_is_the_greatest_share_of_a_rows_error() -> None:
    simulated = np.ones((3, 8))
    solved = simulated + np.array([0.0, 0.1, -0.2])[:, None]
    assert mismatch(solved, simulated, np.inf) == pytest.approx(0.04 / 1.001)
    solved[0, 0] = np.nan
    assert mismatch(solved, simulated, np.inf) == np.inf


def test_walks_find_the_lower_of_two_valleys_and_begin_again_where_they_ended() -> None:
    def residuals(u: FloatArray) -> FloatArray:
        # Valleys at 0.1 and 0.9, of depths 0.09 and 0.
        return np.stack([(u[:, 0] - 0.1) * (u[:, 0] - 0.9), 0.3 * (u[:, 0] < 0.5)], axis=1)

    descents = Descents(None, 1, n_random=2)
    looks, nothing = np.linspace(0.0, 1.0, 11)[:, None], np.empty((0, 1))
    ends, values = descents.lowest(residuals, looks, nothing)
    assert ends[0, 0] == pytest.approx(0.9, abs=1e-3)
    assert (np.diff(values) >= 0.0).all()
    # Without a look near it, the valley is found from where the last walks ended.
    again, _ = descents.lowest(residuals, np.array([[0.1]]), nothing)
    assert again[0, 0] == pytest.approx(0.9, abs=1e-3)


def test_a_learner_is_sure_from_four_rows_until_a_row_jumps() -> None:
    learner, problem = learner_of(cooling())
    learner.note(problem.evaluate(design(3)), is_proposed=False)
    assert not learner.is_believed
    learner.note(problem.evaluate(design(4)[3:]), is_proposed=False)
    assert learner.is_sure
    assert learner.left_out.tolist() == [False, False]
    u = np.random.default_rng(5).random((3, 2))
    expected = problem.evaluate(u).y
    np.testing.assert_allclose(learner.solved(u), expected, atol=1e-6)
    kicked, problem = learner_of(cooling(kick=3.0))
    kicked.note(problem.evaluate(design(5)), is_proposed=False)
    assert not kicked.is_believed


def test_a_learner_takes_equations_over_until_a_row_differs() -> None:
    learner, problem = learner_of(cooling())
    learner.note(problem.evaluate(design(4)), is_proposed=False)
    assert learner.equations is not None
    follower, same = learner_of(cooling())
    follower.follow(learner.equations, learner.known.misfit)
    follower.note(same.evaluate(design(1)), is_proposed=False)
    assert follower.is_sure
    other, jumping = learner_of(cooling(kick=3.0))
    other.follow(learner.equations, learner.known.misfit)
    other.note(jumping.evaluate(design(1)), is_proposed=False)
    assert other.equations is None
