"""The problems, and their data: simulated once per problem and seed by the project's own runner."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pelsvae.linear_network.drive import Drive
from simulation import Case, ParameterSpace, load_case, uniform_design
from simulation.arrays import FloatArray
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel
from studies.calibration.hidden_network.inputs import drive_of
from studies.stages.simulate_stage import TEST_SEED, VALIDATION_SEED, train_seed

ROOT = Path(__file__).parents[3]
N_VALIDATION = N_TEST = 320


@dataclass(frozen=True)
class Problem:
    """A case by name.

    Attributes:
        title: Heading of its table and its panel.
        path: Folder of the case.
        window_d: Days that are simulated; None for the case's own.
    """

    title: str
    path: Path
    window_d: tuple[float, float] | None = None


PROBLEMS = {
    "office": Problem("Office, days 0-10, 14 parameters", ROOT / "fmus" / "office", (0.0, 10.0)),
    "white-box": Problem("White-box office, 21 parameters", ROOT / "fmus" / "office-whitebox-metered"),
    "vanderpol": Problem("Van der Pol, nonlinear, 4 parameters", ROOT / "fmus" / "vanderpol"),
    "wall": Problem("Wall, two outputs, 7 parameters", ROOT / "fmus" / "wall"),
}


@dataclass(frozen=True, eq=False)
class Data:
    """What a surrogate learns from.

    Attributes:
        space: The box; which parameters are logarithmic.
        theta: Training parameters. Shape (n, p). [per parameter]
        y: Training trajectories. Shape (n, t, k). [output's unit]
        validation: Parameters and trajectories for choices. Shapes (m, p), (m, t, k).
        output_scales: What makes errors of the outputs comparable. Shape (k,).
        drive: The model's inputs, for what knows them; None where there are none.
    """

    space: ParameterSpace
    theta: FloatArray
    y: FloatArray
    validation: tuple[FloatArray, FloatArray]
    output_scales: FloatArray
    drive: Drive | None = None

    def first(self, n: int) -> "Data":
        """Return the same with only the first n training rows."""
        return replace(self, theta=self.theta[:n], y=self.y[:n])


@dataclass(frozen=True, eq=False)
class Sets:
    """Everything of one problem and seed.

    Attributes:
        unit: Of the errors, the first output's.
        learnt: With as many training rows as were asked for.
        test: Parameters and trajectories that only judge. Shapes (m, p), (m, t, k).
    """

    unit: str
    learnt: Data
    test: tuple[FloatArray, FloatArray]


def simulated(problem: Problem, seed: int, n: int, folder: Path) -> Sets:
    """Simulate what is not kept yet: the designs of `studies run` with this seed, failed rows left out.

    Args:
        problem: The problem.
        seed: Of the study; draws the training design. Validation and test are the same for all.
        n: Rows of the training design.
        folder: Where simulations are kept.
    """
    case = load_case(problem.path, window_d=problem.window_d)
    with _model(case, folder) as model:

        def ask(design_seed: int, rows: int) -> tuple[FloatArray, FloatArray]:
            found = model.simulate(uniform_design(case.parameter_space, rows, design_seed))
            good = np.array([reason == "" for reason in found.failures])
            return found.theta[good], found.y[good]

        theta, y = ask(train_seed(seed), n)
        learnt = Data(
            space=case.parameter_space,
            theta=theta,
            y=y,
            validation=ask(VALIDATION_SEED, N_VALIDATION),
            output_scales=case.measurement.error_scales,
            drive=drive_of(case),
        )
        unit = case.outputs[0].unit.replace("degC", "K")
        return Sets(unit=unit, learnt=learnt, test=ask(TEST_SEED, N_TEST))


@contextmanager
def _model(case: Case, folder: Path) -> Iterator[StoredModel]:
    with (
        SimulationStore(
            folder / case.name / f"{case.model_digest[:16]}.db",
            model_digest=case.model_digest,
            parameter_names=case.parameter_space.names,
            output_names=case.measurement.output_names,
            time=case.scenario.time,
        ) as store,
        case.open_model() as model,
    ):
        yield StoredModel(model, store)
