"""State equations that are learnt from what a model's states did, and calibrations that follow them."""

from dataclasses import replace

import numpy as np
import pytest
from moving_for_tests import FMUS, Moving, box, learnt, measured, watched_case, with_equations

from simulation.arrays import FloatArray
from simulation.case import load_case
from simulation.errors import InputError
from simulation.parameters import Parameter, ParameterSpace
from studies.calibration.state_equations.coefficient import Points
from studies.calibration.state_equations.states import StateSignals, WatchedModel, watching_states

STEP_S, N_STEPS = 600.0, 120


def weather() -> FloatArray:
    """Outdoor temperature [K], power [W], and whether a fan is on [1], over the steps."""
    time = STEP_S * np.arange(N_STEPS)
    fan = (time % 20000.0 > 12000.0).astype(float)
    return np.column_stack([275.0 + 6.0 * np.sin(time / 9000.0), 400.0 * np.cos(time / 4000.0) ** 2, fan])


SPACE = ParameterSpace(
    (
        *box(R=(4e-3, 1e-1), ROut=(5e-3, 1e-1), GFan=(5.0, 80.0), C=(8e5, 2e7)).parameters,
        Parameter("TStart", 285.0, 295.0),
    )
)
TRUTH = np.array([2e-2, 2e-2, 30.0, 4e6, 291.0])


def two_rooms(roughness: float = 0.0, kick: float = 0.0) -> Moving:
    """Return two rooms, one with a window, a heater and a fan to the other."""

    def slope(r, r_out, fan, c, _, x, y, outdoor, power, is_on):
        c = c * (1.0 + roughness * np.sin(300.0 * np.log(c)))
        between = (y - x) * (1.0 / r + is_on * fan)
        return [(between + (outdoor - x) / r_out + power) / c, -between / (3.0 * c)]

    return Moving(
        SPACE,
        ("K", "K", "K", "W", "1"),
        STEP_S,
        weather(),
        slope,
        lambda *theta: [theta[4], theta[4]],
        offsets=(-273.15,),
        every=2,
        depends_on=(None, frozenset({"x0", "x1", "u2"})),
        kick=kick,
    )


def test_terms_and_trajectories_of_a_network_are_found_from_a_few_rows() -> None:
    model = two_rooms()
    equations = learnt(model, 8)
    first, second, room = (
        {(term.column, term.is_difference, term.factors) for term in one.terms}
        for one in equations.structure.sums
    )
    assert first == {(1, True, ()), (2, True, ()), (3, False, ()), (1, True, (4,))}
    assert second == {(0, True, ()), (0, True, (4,))}
    assert room == {(0, False, ()), (-1, False, ())}
    fresh = np.random.default_rng(1).random((6, 5))
    expected = model.simulate(SPACE.from_unit(fresh)).y[..., :1]
    answered = equations.outputs(Points.of(SPACE, fresh))
    np.testing.assert_allclose(answered, expected, atol=1e-5)


def test_a_calibration_by_equations_takes_two_calls_more_than_it_learns_from() -> None:
    problem = measured(two_rooms(), TRUTH, 0.05)
    found, ode = with_equations(problem, max_calls=40)
    assert ode.is_believed
    assert found.converged
    assert "state equations" in found.stop_reason
    truth = float(problem.mse(problem.space.to_unit(TRUTH[None]))[0])
    assert found.mse < truth
    assert found.history.calls_to(truth) <= 8
    assert found.n_calls <= 12


def test_where_coefficients_are_no_formulas_the_search_does_without() -> None:
    found, ode = with_equations(measured(two_rooms(roughness=0.8), TRUTH, 0.05), max_calls=12)
    assert ode.n_asked == 0
    assert not ode.is_learnt
    assert ode.why_not == "not all coefficients are formulas of the parameters"
    assert found.n_calls == 12
    assert np.isfinite(found.mse)


def test_a_wall_is_calibrated_with_few_calls_and_asks_its_first_design_where_the_best_fit_is_a_bad_one() -> (
    None
):
    """tests/end_to_end/test_tutorials.py asks the same of the office."""
    with watched_case(FMUS / "wall") as (_, problem):
        found, ode = with_equations(problem, max_calls=40, misfit_threshold=0.1)
        bad, _ = with_equations(problem, max_calls=40, misfit_threshold=1e-4)
    assert ode.n_asked > 0
    assert found.n_calls < 7
    assert found.mse <= 1.01 * 0.00192
    # Four points where equations may act that no row has shown, and the rest of the design.
    assert bad.n_calls == 4 + 7 + found.n_calls - 4
    assert found.converged
    assert bad.converged


def test_what_jumps_between_is_not_predicted_and_nothing_is_sure() -> None:
    problem = measured(two_rooms(kick=0.1), TRUTH, 0.05)
    _, ode = with_equations(problem, max_calls=20)
    assert not ode.is_sure
    assert ode.model is None


def test_a_watched_model_answers_what_it_answers_unwatched() -> None:
    case = load_case(FMUS / "wall")
    theta = case.parameter_space.from_unit(np.random.default_rng(0).random((3, 7)))
    signals = StateSignals.of(case)
    with case.open_model() as model, watching_states(case).open_model() as more:
        watched = WatchedModel(more, signals)
        alone, answer = model.simulate(theta), watched.simulate(theta)
    np.testing.assert_array_equal(answer.y, alone.y)
    np.testing.assert_array_equal(answer.time, alone.time)
    assert answer.output_names == alone.output_names
    # The day before the window is the row's own, and is watched from its start.
    assert signals.n_before == 144
    assert watched.seen(theta).x.shape == (3, len(alone.time) + 144, 3)
    assert watching_states(case).model_digest != case.model_digest


def test_an_fmu_without_states_is_refused() -> None:
    case = load_case(FMUS / "wall")
    silent = replace(case, fmu=replace(case.fmu, states=()))
    with pytest.raises(InputError, match=r"declares no states.*leave --state-equations away"):
        watching_states(silent)
