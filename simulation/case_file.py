"""The case file's schema: every key a case.toml may hold, and nothing else."""

from datetime import date
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from simulation.case_parameter import ParameterTable
from simulation.case_table import Finite, Line, Name, Pair, Positive, Table
from simulation.time_unit import DAYS, SECONDS, TimeUnit


def _as_text(value: object) -> object:
    """Return a date of TOML's own as the text that it stands for."""
    return value.isoformat() if isinstance(value, date) else value


class TimeTable(Table):
    """Key [time]: periods in days or, all of them, in seconds; steps in seconds.

    They count from the first row of the first output's file; for timestamps with a `zero`, from that moment,
    which is the model's time 0 as well. The simulation starts at `start_d` (else with the window); with
    `shared_warmup` the part before the window is simulated once. `validation_d` is not calibrated.
    """

    window_d: Pair | None = None
    window_s: Pair | None = None
    start_d: Finite | None = None
    start_s: Finite | None = None
    validation_d: Pair | None = None
    validation_s: Pair | None = None
    zero: Annotated[Name, BeforeValidator(_as_text)] | None = None
    shared_warmup: bool = False
    communication_step_s: Positive
    output_step_s: Positive

    @model_validator(mode="after")
    def _one_unit(self) -> "TimeTable":
        _one_window(self.window_d, self.window_s)
        other = "s" if self.window_s is None else "d"
        for key in ("start", "validation"):
            if getattr(self, f"{key}_{other}") is not None:
                raise ValueError(
                    f"{key}_{other} beside window_{self.unit.symbol}; write {key}_{self.unit.symbol}: "
                    "_d counts days, _s seconds, one of them throughout"
                )
        return self

    @property
    def unit(self) -> TimeUnit:
        """Unit of the periods."""
        return DAYS if self.window_s is None else SECONDS

    @property
    def window(self) -> tuple[float, float]:
        """The part that is compared. [d]."""
        return _in_days(self.window_d, self.window_s) or (0.0, 0.0)

    @property
    def validation(self) -> tuple[float, float] | None:
        """The part that is not calibrated. [d]."""
        return _in_days(self.validation_d, self.validation_s)

    @property
    def start(self) -> float | None:
        """Start of the simulation, None for that of the window. [d]."""
        return self.start_d if self.start_s is None else SECONDS.to_days(self.start_s)


def _one_window(window_d: tuple[float, float] | None, window_s: tuple[float, float] | None) -> None:
    if (window_d is None) == (window_s is None):
        what = "both window_d and window_s are given" if window_d else "key window_d is missing"
        raise ValueError(f"{what}; give one: window_d = [0, 10] in days, or window_s = [0, 10] in seconds")


def _in_days(
    days: tuple[float, float] | None, seconds: tuple[float, float] | None
) -> tuple[float, float] | None:
    return days if seconds is None else (SECONDS.to_days(seconds[0]), SECONDS.to_days(seconds[1]))


class InputTable(Table):
    """Key [[inputs]]: where an FMU input comes from; gaps up to `max_gap_s` are bridged.

    `fmu_unit` is the unit that its equations count in, where the FMU declares none.
    """

    name: Name
    file: Name
    column: Name | None = None
    sum: dict[str, Finite] | None = None
    unit: Line
    fmu_unit: Name | None = None
    interpolation: Literal["held", "linear", "smooth"]
    max_gap_s: Positive | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "InputTable":
        if (self.column is None) == (not self.sum):
            raise ValueError("give either column or sum, not both and not neither")
        return self

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each column in the input."""
        return {self.column: 1.0} if self.column is not None else dict(self.sum or {})


class OutputTable(Table):
    """Key [[outputs]]: an FMU output and its measurement, which may have times of its own and gaps.

    `weight` is the share of the error that it has relative to the others (see Measurement), `accepted` the
    band outside of which a simulation has failed, `error_lasts_s` how long an error of it lasts (see
    calibration.prior); `fmu_unit` as for inputs.
    """

    name: Name
    unit: Line
    fmu_unit: Name | None = None
    file: Name
    column: Name
    uncertainty: Positive
    error_lasts_s: Positive | None = None
    weight: Positive = 1.0
    accepted: Pair | None = None


class FirstMeasured(Table):
    """Value of [fixed]: the measured value of an output at the start of the simulation."""

    first_measured: Name


class ValueWithUnit(Table):
    """Value of [fixed]: a number with its unit, converted to the FMU's."""

    value: Finite
    unit: Name


# A float where it is larger than any integer of an FMU.
_Whole = Annotated[int, Field(ge=-(2**63), lt=2**64)]
FixedValue = bool | _Whole | Finite | str | FirstMeasured | ValueWithUnit


class SimulationTable(Table):
    """Key [simulation]: how patiently simulations are run; changes no answer. See ExecutionPolicy.

    `timeout_s = inf` waits for ever.
    """

    timeout_s: Annotated[float, Field(gt=0, allow_inf_nan=True)] | None = None
    retries: Annotated[int, Field(ge=0)] = 1
    max_failed_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    max_workers: Annotated[int, Field(ge=1)] | None = None


class ReferenceTable(Table):
    """Key [[references]]: a mean squared error that is known for a window, to judge results by."""

    label: Name
    window_d: Pair | None = None
    window_s: Pair | None = None
    mse: Positive
    target: bool = False

    @model_validator(mode="after")
    def _one_unit(self) -> "ReferenceTable":
        _one_window(self.window_d, self.window_s)
        return self

    @property
    def window(self) -> tuple[float, float] | None:
        """The window. [d]."""
        return _in_days(self.window_d, self.window_s)


class CaseFile(Table):
    """A whole case.toml."""

    # Later schemas must say so, else an old program would read a new file wrongly.
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=64)]
    title: str = ""
    note: str = ""
    fmu: Name
    interface: Literal["co-simulation", "model-exchange"] = "co-simulation"
    relative_tolerance: Annotated[float, Field(gt=0, lt=1)] | None = None
    data: Line = "."
    data_origin: str = ""
    time_column: Name | None = None
    timezone: Name | None = None
    time: TimeTable
    inputs: list[InputTable] = Field(default_factory=list)
    outputs: Annotated[list[OutputTable], Field(min_length=1)]
    parameters: Annotated[list[ParameterTable], Field(min_length=1)]
    fixed: dict[str, FixedValue] = Field(default_factory=dict)
    simulation: SimulationTable = SimulationTable()
    references: list[ReferenceTable] = Field(default_factory=list)
