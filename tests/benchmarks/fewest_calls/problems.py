"""The problems by family, their seeded instances, and the best error that brute force finds."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from multistart_for_tests import multistart

from fewest_calls.instances import Instance, of_case
from fewest_calls.instances_office import WINDOWS_D, office_instance
from simulation import Case, Trajectories, load_case
from simulation.arrays import FloatArray
from simulation.experiments import JoinedModel
from simulation.forward_model import ForwardModel, WrappedModel
from studies.calibration.hidden_network.inputs import network_of_stores
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.state_equations.experiments_ode import learned_ode, watched_model
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.states import watching_states

ROOT = Path(__file__).parents[3]
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Problem:
    """A problem by name, opened when it is wanted.

    Attributes:
        name: As in the table.
        family: Its panel of the picture.
        make: Reads or draws the case; of an instance also the point that the truth was built around.
        most_calls: Limit of every method's budget, for models that answer slowly.
        n_starts: Starts of least squares in the brute force.
        n_evolutions: Differential evolutions in the brute force, for errors that jump.
    """

    name: str
    family: str
    make: Callable[[], Instance]
    most_calls: int = 5000
    n_starts: int = 24
    n_evolutions: int = 0


@dataclass(frozen=True)
class Best:
    """The best error known and how it was found.

    Attributes:
        mse: The error. [first output's unit squared]
        how: In words.
    """

    mse: float
    how: str


FAMILIES = {
    "office": "Office, virtual measurement",
    "office-recorded": "Office, recorded",
    "office instances": "Office, drawn",
    "white box": "White-box office, 21 parameters",
    "wall": "Wall, two outputs",
    "two-rooms": "Two rooms, seven experiments",
    "vanderpol": "Van der Pol, nonlinear",
    "thermostat": "Thermostat, events",
    "heating circuit": "Heating circuit, two switches",
    "heat pump": "Heat pump, shortest time between switchings",
    "two basins": "Slab, two basins",
    "office inside": "Office, weather inside",
    "wall inside": "Wall, weather inside",
    "house inside": "House, weather inside",
}
_ONE_CASE = {
    "wall": (ROOT / "fmus" / "wall", 5000, 24, 0),
    "two-rooms": (ROOT / "fmus" / "two-rooms", 5000, 8, 0),
    "vanderpol": (ROOT / "fmus" / "vanderpol", 5000, 40, 1),
    "thermostat": (ROOT / "fmus" / "thermostat", 2000, 12, 2),
    "heating circuit": (HERE / "heating_circuit", 2000, 8, 1),
    "heat pump": (HERE / "heat_pump", 2000, 8, 1),
    "two basins": (HERE / "slab", 5000, 24, 0),
    "office inside": (HERE / "office_inside", 5000, 8, 0),
    "wall inside": (HERE / "wall_inside", 5000, 8, 0),
    "house inside": (HERE / "house_inside", 5000, 8, 0),
}

_NO_INSTANCES = ("two-rooms",)


def problems(instances: Sequence[int]) -> Iterator[Problem]:
    """Yield all problems for which there are data.

    Args:
        instances: Seeds of the instances of every family.
    """
    is_recorded = (ROOT / "data" / "office-recorded" / "recording_1800s.csv").is_file()
    for name in ("office-recorded", "office") if is_recorded else ("office",):
        for window_d in WINDOWS_D:
            make = partial(_case, ROOT / "fmus" / name, window_d)
            yield Problem(f"{name}, days {window_d[0]:g}-{window_d[1]:g}", name, make)
    for seed in instances:
        yield Problem(f"office, instance {seed}", "office instances", partial(office_instance, seed))
    folder = ROOT / "fmus" / "office-whitebox-metered"
    paths = {
        "white box": folder / "case.toml",
        "white box, recorded": folder / "office-whitebox-recorded.toml",
    }
    for name, path in paths.items() if is_recorded else (("white box", folder / "case.toml"),):
        yield Problem(name, "white box", partial(_case, path, None), most_calls=400, n_starts=4)
    for seed in instances:
        make = partial(_instance, folder, seed)
        yield Problem(f"white box, instance {seed}", "white box", make, most_calls=400, n_starts=1)
    for family, (path, most_calls, n_starts, n_evolutions) in _ONE_CASE.items():
        yield Problem(family, family, partial(_case, path, None), most_calls, n_starts, n_evolutions)
        for seed in instances if family not in _NO_INSTANCES else ():
            make = partial(_instance, path, seed)
            name = f"{family}, instance {seed}"
            yield Problem(name, family, make, most_calls, n_starts, n_evolutions)


def _case(path: Path, window_d: tuple[float, float] | None) -> Instance:
    case = load_case(path, window_d=window_d)
    return Instance(case, np.empty(0))


def _instance(path: Path, seed: int) -> Instance:
    return of_case(load_case(path), seed)


class CountedExperiments(JoinedModel):
    """Experiments that count what is simulated in single ones.

    Attributes:
        n_alone: Simulations of single experiments.
    """

    n_alone = 0

    def simulate_alone(self, theta: FloatArray, place: int) -> Trajectories:
        """Count and simulate every row in one experiment."""
        self.n_alone += len(theta)
        return super().simulate_alone(theta, place)


class PosedModel(WrappedModel):
    """A case's model that remembers what the states did, and what drives it."""

    def __init__(self, model: ForwardModel, case: Case) -> None:
        """Wrap the model of a case that watches its states, that of all its experiments where it has some."""
        self.states, self._case, self._answers = watched_model(case, model), case, model
        super().__init__(self.states)
        self.network_inputs = network_of_stores(case)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate; a row of several experiments is one call."""
        return self.states.simulate(theta)

    @property
    def rows_alone(self) -> float:
        """Rows that what was simulated in single experiments is worth."""
        if not isinstance(self._answers, CountedExperiments):
            return 0.0
        return self._answers.n_alone / len(self._case.experiments)

    def learned_ode(self, problem: CalibrationProblem) -> LearnedODE:
        """Return what learns the state equations of a problem that is posed to this model."""
        return learned_ode(self._case, self.states, problem)


@contextmanager
def posed(case: Case) -> Iterator[CalibrationProblem]:
    """Open a case's model and pose its problem; what the states did is there for who looks."""
    with_states = watching_states(case)
    if case.layout is None:
        with with_states.open_model() as model:
            yield CalibrationProblem(PosedModel(model, case), case.measurement)
        return
    rows = with_states.experiment_rows
    with closing(rows.open()) as parts:
        joined = CountedExperiments(parts, rows, case.parameter_space)
        yield CalibrationProblem(PosedModel(joined, case), case.measurement, layout=case.layout)


def brute_force(problem: CalibrationProblem, posed_as: Problem, made: Instance) -> Best:
    """Find the best error known: least squares, evolutions, the truth, and what the case knows.

    Args:
        problem: The problem.
        posed_as: How much force.
        made: The case and, of an instance, the point that the truth was built around.
    """
    # A model that answers slowly gets as many calls per start as it takes to see where the start leads.
    most = 1000 if posed_as.most_calls < 1000 else 20_000
    patient = LeastSquaresTRF(ftol=1e-9, xtol=1e-10, max_calls=most)
    runs = multistart(problem, posed_as.n_starts, 0, polishing=patient)
    found = {f"the best of {posed_as.n_starts} starts of least squares": runs.best.mse}
    if made.u.size:
        found["least squares from the true parameters"] = patient.minimize(problem, made.u).mse
    for seed in range(posed_as.n_evolutions):
        found[f"differential evolution {seed} and least squares"] = _evolved(problem, patient, seed)
    for known in made.case.references:
        if known.label == "best known":
            # Written with four digits, the last one rounded.
            found["the case's own best known"] = known.mse * 1.0005
    how, mse = min(found.items(), key=lambda one: one[1])
    near = int((runs.mse <= 1.02 * mse).sum())
    return Best(float(mse), f"{how}; {near} of {posed_as.n_starts} starts of least squares come within 1.02")


def _evolved(problem: CalibrationProblem, patient: LeastSquaresTRF, seed: int) -> float:
    evolution = DifferentialEvolution(popsize=8, maxiter=150, tol=1e-4)
    screened = evolution.minimize(problem, seed=seed)
    u: FloatArray = screened.u
    return min(screened.mse, patient.minimize(problem, u).mse)
