"""State equations of several experiments: learnt in few of them, taken over in the others, and given up."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from two_rooms_for_tests import two_rooms_with

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.experiments import JoinedModel
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult
from studies.calibration.state_equations.experiments_ode import learned_ode, watched_model
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.states import watching_states


class SecondIsWarmer(JoinedModel):
    """Experiments of which the second one's rooms lose less heat than the equations of the first say."""

    def simulate_alone(self, theta: FloatArray, place: int) -> Trajectories:
        return super().simulate_alone(self._changed(theta) if place == 1 else theta, place)

    def simulate(self, theta: FloatArray) -> Trajectories:
        layout = self.rows.layout
        answers = [
            replace(self.simulate_alone(theta, place), theta=layout.theta_of(one, theta))
            for place, one in enumerate(layout.experiments)
        ]
        return layout.join(theta, answers)

    def _changed(self, theta: FloatArray) -> FloatArray:
        changed = theta.copy()
        changed[:, self.parameter_space.names.index("G1")] *= 0.8
        return changed


@contextmanager
def calibrated(
    case: Case, kind: type[JoinedModel] = JoinedModel, max_calls: int = 40
) -> Iterator[tuple[AdaptiveResult, LearnedODE]]:
    rows = watching_states(case).experiment_rows
    with closing(rows.open()) as parts:
        model = watched_model(case, kind(parts, rows, case.parameter_space))
        problem = CalibrationProblem(model, case.measurement, layout=case.layout)
        ode = learned_ode(case, model, problem)
        yield Adaptive(max_calls=max_calls).minimize(problem, seed=0, learned_ode=ode), ode


def test_experiments_that_differ_in_inputs_and_start_values_cost_one_row_after_four_simulations(
    tmp_path: Path,
) -> None:
    case = two_rooms_with(tmp_path, "cooling", "heater-1", "random", "together")
    with calibrated(case) as (found, ode):
        assert ode.n_alone == 4
        # Four of four experiments are worth one row.
        assert found.n_calls == 2
        assert found.converged
        assert found.mse == pytest.approx(0.05**2, rel=0.1)


def test_an_experiment_in_which_an_input_rests_says_nothing_of_it(tmp_path: Path) -> None:
    case = two_rooms_with(tmp_path, "heater-1", "heater-2")
    with calibrated(case) as (found, ode):
        assert ode.n_alone == 8
        assert found.n_calls == 5
        assert found.converged


def test_one_simulation_shows_what_another_fixed_value_adds(tmp_path: Path) -> None:
    case = two_rooms_with(tmp_path, "random", "together", "door")
    with calibrated(case) as (found, ode):
        assert ode.n_alone == 5
        # Five of three experiments are worth two rows.
        assert found.n_calls == 3
        assert found.converged
        assert found.mse == pytest.approx(0.05**2, rel=0.1)


def test_an_experiment_in_which_a_fixed_value_adds_no_product_is_learnt_by_itself(tmp_path: Path) -> None:
    case = two_rooms_with(tmp_path, "random", "door")
    with calibrated(case, SecondIsWarmer) as (found, ode):
        assert ode.n_alone == 8
        assert found.converged


def test_equations_that_another_experiment_contradicts_are_learnt_there_from_whole_rows(
    tmp_path: Path,
) -> None:
    case = two_rooms_with(tmp_path, "random", "together")
    with calibrated(case, SecondIsWarmer) as (found, ode):
        # What was simulated alone is in the rows of the design that were asked then.
        assert ode.n_alone == 0
        assert ode.is_sure
        assert found.converged
        assert 5 <= found.n_calls <= 12


def test_a_failure_in_one_experiment_leaves_the_search_to_whole_rows(tmp_path: Path) -> None:
    class FirstFails(JoinedModel):
        def simulate_alone(self, theta: FloatArray, place: int) -> Trajectories:
            answer = super().simulate_alone(theta, place)
            return replace(answer, y=np.full_like(answer.y, np.nan), failures=("it fails",) * len(theta))

    case = two_rooms_with(tmp_path, "random", "together")
    with calibrated(case, FirstFails) as (found, ode):
        assert ode.n_alone == 0
        assert found.converged
        assert found.n_calls <= 8


def test_a_small_budget_is_kept_and_holds_a_whole_row(tmp_path: Path) -> None:
    case = two_rooms_with(tmp_path, "heater-1", "heater-2")
    with calibrated(case, max_calls=3) as (found, ode):
        assert ode.n_alone == 0
        assert found.n_calls == 3
        assert np.isfinite(found.mse)


def test_without_equations_own_parameters_do_not_make_a_first_design_larger(tmp_path: Path) -> None:
    case = two_rooms_with(tmp_path, "random", "together", "door", "cooling")
    rows = watching_states(case).experiment_rows
    with closing(rows.open()) as parts:
        model = watched_model(case, JoinedModel(parts, rows, case.parameter_space))
        problem = CalibrationProblem(model, case.measurement, layout=case.layout)
        assert (problem.n_acting, problem.space.n_parameters) == (9, 12)
        found = Adaptive(max_calls=30).minimize(problem, seed=0)
    # Four times the 28 rows that one experiment alone takes would be allowed.
    assert found.mse == pytest.approx(0.05**2, rel=0.1)
