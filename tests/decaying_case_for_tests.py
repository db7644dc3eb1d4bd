"""Cases around one state with a closed form, x' = -k x + u, recorded with known parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from c_fmu_for_tests import write_fmu
from scipy.optimize import least_squares

from simulation.arrays import FloatArray
from simulation.case import load_case

SOURCE = Path(__file__).parent / "simulation" / "decay.c"
TRUE_K, TRUE_X0 = 1.4e-4, 312.0
"""Of every recording. [1/s, K]"""
NOISE_K = 0.05


def driving(time: FloatArray) -> FloatArray:
    """Return what drives the state: a swing that is not the same in reverse. Shape (t,). [K/s]."""
    return TRUE_K * (293.0 + 8.0 * np.sin(time / 7000.0) + 4.0 * np.sin(time / 2900.0))


def states(time: FloatArray, *, finest_s: float = 10.0) -> FloatArray:
    """Return the state of the true parameters at times from 0 on, solved in small steps. Shape (t,). [K]."""
    fine = np.arange(0.0, time[-1] + finest_s, finest_s)
    u, x = driving(fine), np.empty(len(fine))
    x[0] = TRUE_X0
    a = np.exp(-TRUE_K * finest_s)
    for i in range(len(fine) - 1):
        x[i + 1] = x[i] * a + 0.5 * (u[i] + u[i + 1]) * (1.0 - a) / TRUE_K
    return np.interp(time, fine, x)


def noise(n: int, seed: int = 0) -> FloatArray:
    """Return the sensor's. Shape (n,). [K]."""
    return NOISE_K * np.random.default_rng(seed).standard_normal(n)


@dataclass(frozen=True)
class DecayingCase:
    """A case to be written, whose every part may be another.

    Attributes:
        inputs: Text of the CSV file of the input.
        measured: Text of the CSV file of the measurement.
        time: Keys of [time].
        output: Further keys of the output.
        top: Further keys at the top.
        change: What replaces parts of the model description.
    """

    inputs: str = ""
    measured: str = ""
    time: str = "window_s = [0, 57600]"
    output: str = ""
    top: str = ""
    change: Mapping[str, str] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write it into `fmus/decay` of a project; return the case file."""
        case = folder / "fmus" / "decay"
        case.mkdir(parents=True)
        description = SOURCE.with_suffix(".xml").read_text()
        for old, new in self.change.items():
            assert old in description, old
            description = description.replace(old, new)
        write_fmu(case / "decay.fmu", description, SOURCE)
        time = np.arange(0.0, 57601.0, 600.0)
        usual = (
            table("time_s,u", time, driving(time)),
            table("time_s,x", time, states(time) + noise(len(time))),
        )
        (case / "inputs.csv").write_text(self.inputs or usual[0])
        (case / "measured.csv").write_text(self.measured or usual[1])
        text = CASE.format(time=self.time, output=self.output, top=self.top)
        (case / "case.toml").write_text(text)
        (folder / "studies.toml").touch()
        return case / "case.toml"


def table(header: str, *columns: FloatArray) -> str:
    """Return a CSV file of numbers."""
    rows = (",".join(f"{value:.10g}" for value in row) for row in zip(*columns, strict=True))
    return "\n".join([header, *rows]) + "\n"


def fitted(file: Path) -> tuple[float, float, float]:
    """Return k [1/s], x0 [K] and the root mean square error [K] of the best fit to a case."""
    case = load_case(file)
    start = np.array([np.log(1e-4), 300.0])
    with case.open_model() as model:

        def residuals(u: FloatArray) -> FloatArray:
            answer = model.simulate(np.array([[np.exp(u[0]), u[1]]]))
            assert not answer.failures[0], answer.failures
            return case.measurement.compared(answer.y)[0]

        found = least_squares(residuals, start, x_scale=(0.1, 1.0), diff_step=1e-5)
    return float(np.exp(found.x[0])), float(found.x[1]), float(np.sqrt(np.mean(found.fun**2)))


CASE = """schema = 1
name = "decay"
fmu = "decay.fmu"
{top}
[time]
{time}
communication_step_s = 600
output_step_s = 600

[[inputs]]
name = "u"
file = "inputs.csv"
column = "u"
unit = "K/s"
interpolation = "linear"

[[outputs]]
name = "y"
unit = "K"
file = "measured.csv"
column = "x"
uncertainty = 0.05
{output}

[[parameters]]
name = "k"
lower = 2e-5
upper = 5e-4
unit = "1/s"
scale = "log"

[[parameters]]
name = "x0"
lower = 280
upper = 340
unit = "K"
"""
