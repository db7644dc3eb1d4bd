"""Switches among the states: their positions, when they change, and the equations solved with them."""

from pathlib import Path

import numpy as np
import pytest
from moving_for_tests import FMUS, watched_case, with_equations

from simulation.arrays import FloatArray
from studies.calibration.state_equations.flow import SteppedFlow
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.states import StateSignals
from studies.calibration.state_equations.switch_positions import with_switches
from studies.calibration.state_equations.terms import Sum, Term

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
STEP_S, N_STEPS = 1.0, 40
PLAIN = StateSignals(
    states=("T",),
    derivatives=("der(T)",),
    inputs=(),
    units=("K",),
    depends_on=(frozenset({"T"}),),
    driven=np.empty((N_STEPS, 0)),
    step_s=STEP_S,
    every=1,
    n_before=0,
    outputs=("T",),
    conversions=np.array([[1.0, 0.0]]),
    locals=("on", "power", "off", "schedule", "level", "standby"),
    local_units=("1", "W", "1", "1", "1", "W"),
)
SWITCHED = with_switches(PLAIN, ["on"])


def relay(waits: tuple[float, float], n_parts: int = 1) -> FloatArray:
    """Solve T' = 2 on - 1 from 0, on until 3.3 and off until -1.1. Shape (t, 2)."""
    rules = np.array([[1, 0, 0, 3, -1], [1, 1, 0, 3, 1]])
    flow = SteppedFlow(SWITCHED, (Sum(0, (Term(1), Term(-1))), Sum(1, (Term(-1),))), rules, n_parts)
    rates = [np.array([[2.0, -1.0]]), np.zeros((1, 1)), np.array([[-1.1, 3.3, *waits]])]
    return flow.states(np.array([[0.0], [1.0]]), rates)[0]


def saw_tooth(turns_s: FloatArray, heights: FloatArray) -> FloatArray:
    """The same in closed form, from where it turns."""
    return np.interp(STEP_S * np.arange(N_STEPS + 1), turns_s, heights)


@pytest.mark.parametrize("n_parts", [1, 7])
def test_a_switch_changes_within_steps(n_parts: int) -> None:
    found = relay((0.0, 0.0), n_parts)
    turns = np.concatenate([[0.0], 3.3 + 4.4 * np.arange(10)])
    expected = saw_tooth(turns, np.array([0.0, *[3.3, -1.1] * 5]))
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-8)
    assert set(np.unique(found[:, 1])) == {0.0, 1.0}


def test_a_switch_waits_since_its_last_change() -> None:
    # Turned off late, after 5.5, it falls for 6.6 to its other threshold; then 5.5 is always the longer time.
    turns = np.concatenate([[0.0, 5.5], 12.1 + 5.5 * np.arange(7)])
    expected = saw_tooth(turns, np.array([0.0, 5.5, *[-1.1, 4.4] * 3, -1.1]))
    np.testing.assert_allclose(relay((5.5, 5.5))[:, 0], expected, atol=1e-8)


@pytest.mark.slow
def test_a_thermostat_is_solved_anywhere_in_the_box_and_takes_five_calls() -> None:
    with watched_case(FMUS / "thermostat") as (case, problem):
        found, ode = with_equations(problem, max_calls=20)
        assert ode.model is not None
        theta = case.parameter_space.from_unit(np.random.default_rng(1).random((8, 6)))
        solved, simulated = ode.model.simulate(theta), problem.model.simulate(theta)
    assert found.n_calls == 5
    assert found.converged
    assert found.mse < 1.01 * case.references[0].mse
    np.testing.assert_allclose(solved.y, simulated.y, atol=1e-5)
    # A point is solved the same alone and beside others.
    np.testing.assert_array_equal(ode.model.simulate(theta[2:3]).y, solved.y[2:3])


@pytest.mark.parametrize(("name", "n_rules", "n_rows"), [("heating_circuit", 4, 4), ("heat_pump", 2, 12)])
def test_two_switches_and_a_shortest_time_are_learnt(name: str, n_rules: int, n_rows: int) -> None:
    with watched_case(BENCHMARKS / "fewest_calls" / name) as (case, problem):
        u = np.random.default_rng(0).random((n_rows + 4, case.parameter_space.n_parameters))
        ode = LearnedODE.of(problem)
        ode.note(problem.evaluate(u[:4]))
        if n_rows > 4:
            # Four rows do not separate the shortest time from a threshold.
            assert "changes at no threshold that was found" in ode.why_not
            ode.note(problem.evaluate(u[4:n_rows]))
        assert ode.model is not None
        solved, simulated = ode.model.simulate(case.parameter_space.from_unit(u)), problem.evaluate(u)
    np.testing.assert_allclose(solved.y, simulated.y, atol=0.05)
    assert len(ode.model.equations.limits) == 2 * n_rules
