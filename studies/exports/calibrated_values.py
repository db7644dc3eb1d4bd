"""The best calibration of a case as the values of its FMU's variables, and what made it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulation.case import Case, of_experiment
from simulation.errors import InputError
from simulation.fmi.variable import FmuVariable, Value
from simulation.foreign_text import shortened
from studies.project import FinishedCalibration, Project, best_calibrations
from studies.provenance import case_of, read_provenance
from studies.report.wording import square_of


@dataclass(frozen=True)
class SetValue:
    """The value of one variable.

    Attributes:
        variable: The FMU's variable.
        value: Its value; the number of an item for an enumeration. [unit]
        unit: Unit of the FMU, or of the case where the FMU declares none; "" for none.
        origin: "calibrated" or "fixed".
    """

    variable: FmuVariable
    value: Value
    unit: str
    origin: str

    @property
    def name(self) -> str:
        """Name of the variable."""
        return self.variable.name

    @property
    def text(self) -> str:
        """The value as XML writes it, with all digits of a number."""
        return str(self.value).lower() if isinstance(self.value, bool) else str(self.value)


@dataclass(frozen=True)
class CalibratedValues:
    """What sets an FMU as the best calibration of a case did.

    Attributes:
        case: The case.
        finished: The calibration.
        values: Calibrated parameters, then what the case holds under [fixed].
    """

    case: Case
    finished: FinishedCalibration
    values: tuple[SetValue, ...]

    @property
    def about(self) -> dict[str, Any]:
        """What made the values, as JSON values."""
        changed = {"made_before_change_of": [*self.finished.changed_since]}
        error = self.finished.found.error_name.lower().replace(" ", "_")
        return {
            "case": self.case.name,
            **({"experiment": self.case.experiment} if self.case.experiment else {}),
            "case_digest": self.case.digest,
            "command": str(self.finished.outcome.provenance["command"]),
            "finished": self.finished.outcome.finished,
            error: self.finished.found.mse,
            f"{error}_unit": square_of(self.finished.found.output_unit),
            **(changed if self.finished.changed_since else {}),
        }

    @property
    def sentence(self) -> str:
        """The same in one line."""
        return shortened(", ".join(f"{name}: {value}" for name, value in self.about.items()), 1000)


def calibrated_values(project: Project, experiment: str | None = None) -> CalibratedValues:
    """Return the best calibration of the one case of a project.

    Args:
        project: What the project holds of the case.
        experiment: Which of its experiments; None where it has none.

    Raises:
        InputError: There is none, there are several cases, or the case is not as it was calibrated.
    """
    best = best_calibrations(project)
    if len(best) != 1:
        cases = ", ".join(one.found.case for one in best)
        remedy = f"name one of: {cases}" if cases else "type studies calibrate first"
        raise InputError(f"--write needs one calibrated case; {remedy}")
    (finished,) = best
    made = read_provenance(finished.outcome.provenance, finished.name)
    case = case_of(project.paths, made, exactly=False)
    case, columns = of_experiment(case, experiment, needed_for="--write")
    space, fmu = case.parameter_space, case.fmu
    theta = np.array([*finished.found.theta.values()])[columns]
    units = {one.name: one.unit for one in space.parameters}
    variables = [fmu.variables[name] for name in case.settings.set_names]
    in_fmu = case.settings.parameters_for_fmu(theta).tolist()
    values = [
        SetValue(variable, value, variable.unit or units.get(variable.name, ""), "calibrated")
        for variable, value in zip(variables, in_fmu, strict=True)
    ]
    fixed = ((fmu.variables[name], value) for name, value in case.fixed.items())
    values += [SetValue(variable, value, variable.unit, "fixed") for variable, value in fixed]
    return CalibratedValues(case, finished, tuple(values))
