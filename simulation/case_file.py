"""The case file's schema: every key a case.toml may hold, and what its keys alone may contradict."""

import difflib
from collections import Counter
from datetime import date
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from simulation.fmi.variable import Interface
from simulation.foreign_text import has_control, shortened
from simulation.parameters import Belief, Parameter, Scale
from simulation.robust_loss import USUAL_SCALE, LossKind, RobustLoss
from simulation.samples import MOMENT
from simulation.scenario import Interpolation
from simulation.time_unit import DAYS, SECONDS, TimeUnit
from simulation.timestamps import StampForm, zone_named


def _without_control(name: str) -> str:
    if has_control(name):
        raise ValueError("holds a control character or an end of a line; write it without")
    return name


def _as_text(value: object) -> object:
    """Return a date of TOML's own as the text that it stands for."""
    return value.isoformat() if isinstance(value, date) else value


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Line = Annotated[str, AfterValidator(_without_control)]
Name = Annotated[Line, Field(min_length=1)]
Label = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=64)]
# TOML arrays arrive as lists; strict mode would take no list for a tuple.
Pair = Annotated[tuple[Finite, Finite], Field(strict=False)]
# A float where it is larger than any integer of an FMU.
_Whole = Annotated[int, Field(ge=-(2**63), lt=2**64)]


class Table(BaseModel):
    """A table of a case file: no unknown key, no silent conversion."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, content: Any) -> Any:
        """Refuse an unknown key before others are missed: it may be one of them, misspelt."""
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in content if isinstance(content, dict) else ():
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {close[0]}?" if close else f"known: {shortened(', '.join(known), 1000)}"
                raise PydanticCustomError("unknown_key", "unknown", {"key": key, "hint": hint})
        return content


class _WindowTable(Table):
    """What has a window, in days or in seconds."""

    window_d: Pair | None = None
    window_s: Pair | None = None

    @model_validator(mode="after")
    def _one_window(self) -> Self:
        if (self.window_d is None) == (self.window_s is None):
            what = "both window_d and window_s are given" if self.window_d else "key window_d is missing"
            raise ValueError(
                f"{what}; give one: window_d = [0, 10] in days, or window_s = [0, 10] in seconds"
            )
        return self

    @property
    def unit(self) -> TimeUnit:
        """Unit of the window and what is beside it."""
        return DAYS if self.window_s is None else SECONDS

    @property
    def window(self) -> tuple[float, float]:
        """The window. [d]."""
        return _in_days(self.window_d, self.window_s) or (0.0, 0.0)


def _in_days(
    days: tuple[float, float] | None, seconds: tuple[float, float] | None
) -> tuple[float, float] | None:
    return days if seconds is None else (SECONDS.to_days(seconds[0]), SECONDS.to_days(seconds[1]))


class TimeTable(_WindowTable):
    """Key [time]: periods in days or, all of them, in seconds; steps in seconds.

    They count from the model's time 0. Of a column of seconds, minutes, hours or days it is the 0 of the
    column; of timestamps it is the first row of the first output's file. `zero` names another moment. Write
    `window_d` or `window_s`, and the other periods like it.

    Attributes:
        window_d: begin and end of what is calibrated.
        window_s: the same in seconds.
        start_d: start of the simulation; without it, that of the window. The part between is a warm-up.
        start_s: the same in seconds.
        validation_d: begin and end of a part that is not calibrated, to try the result on.
        validation_s: the same in seconds.
        zero: the timestamp of time 0, for recordings with timestamps; or "first" for the first row of the
            first output's file.
        fmu_unit: unit of the FMU's own time, as "h", where the FMU declares none; without it, seconds.
        communication_step_s: step of a co-simulation, over which its inputs are held.
        output_step_s: step of the outputs, a multiple of the communication step.
    """

    start_d: Finite | None = None
    start_s: Finite | None = None
    validation_d: Pair | None = None
    validation_s: Pair | None = None
    zero: Annotated[Name, BeforeValidator(_as_text)] | None = None
    fmu_unit: Name | None = None
    communication_step_s: Positive
    output_step_s: Positive

    @model_validator(mode="after")
    def _one_unit(self) -> Self:
        other = "s" if self.unit is DAYS else "d"
        for key in ("start", "validation"):
            if getattr(self, f"{key}_{other}") is not None:
                raise ValueError(
                    f"{key}_{other} beside window_{self.unit.symbol}; write {key}_{self.unit.symbol}: "
                    "_d counts days, _s seconds, one of them throughout"
                )
        return self

    @property
    def validation(self) -> tuple[float, float] | None:
        """The part that is not calibrated. [d]."""
        return _in_days(self.validation_d, self.validation_s)

    @property
    def start(self) -> float | None:
        """Start of the simulation, None for that of the window. [d]."""
        return self.start_d if self.start_s is None else SECONDS.to_days(self.start_s)


Stamp = Literal["end", "begin", "centre"]


def _one_length(table: "InputTable | OutputTable") -> float | None:
    """Return over how long samples go, None for moments. [s].

    Raises:
        ValueError: If it is said twice, or what of it a time is and not how long it is.
    """
    if table.mean_over_s is not None and table.sum_over_s is not None:
        raise ValueError("a sample is a mean or a sum; drop mean_over_s or sum_over_s")
    length_s = table.mean_over_s or table.sum_over_s
    if table.mean_stamp != "end" and length_s is None:
        raise ValueError("mean_stamp is of means; add mean_over_s, how long each of them goes, or drop it")
    return length_s


def _interval(length_s: float | None, stamp: Stamp) -> tuple[float, float]:
    """Return from when on and until when a sample says something, relative to its time. [s]."""
    if length_s is None:
        return MOMENT
    # What of the interval lies after the stamp.
    after_s = {"end": 0.0, "begin": 1.0, "centre": 0.5}[stamp] * length_s
    return after_s - length_s, after_s


class InputTable(Table):
    """Key [[inputs]]: where an FMU input comes from; either `column` or `sum` is given.

    Attributes:
        name: the input of the FMU.
        file: file in the folder `data`: CSV, Parquet, or a sheet of a workbook, as "runs.xlsx#Sheet".
        column: column of the file.
        sum: weight of each column, where an input is a weighted sum of columns.
        unit: unit of the column.
        fmu_unit: unit that the FMU's equations count in, where the FMU declares none.
        interpolation: between two samples: held (switches, setpoints), linear or smooth (weather).
        mean_over_s: length of the interval that each sample is the mean over; without it, a sample is the
            value of a moment. Held, it holds over its interval; smooth, the course has the same means.
        sum_over_s: the same of sums, as kWh of an hour for an input in W: `unit` is that of the sum.
        mean_stamp: what of the interval the time of a sample is: its end, begin or centre.
        max_gap_s: longest gap that is bridged; without it, a gap is an error.
    """

    name: Name
    file: Name
    column: Name | None = None
    sum: dict[str, Finite] | None = None
    unit: Line
    fmu_unit: Name | None = None
    interpolation: Literal["held", "linear", "smooth"]
    mean_over_s: Positive | None = None
    sum_over_s: Positive | None = None
    mean_stamp: Stamp = "end"
    max_gap_s: Positive | None = None

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        if (self.column is None) == (not self.sum):
            raise ValueError("give either column or sum, not both and not neither")
        length_s = _one_length(self)
        if length_s is not None and self.interpolation == "linear":
            raise ValueError('interpolation = "linear" between means changes them; write "held" or "smooth"')
        return self

    @property
    def interval(self) -> tuple[float, float]:
        """From when on and until when a sample says something, relative to its time. [s]."""
        return _interval(self.mean_over_s, self.mean_stamp)

    @property
    def course(self) -> Interpolation:
        """What the input is between two samples."""
        return (
            "spread"
            if self.mean_over_s is not None and self.interpolation == "smooth"
            else self.interpolation
        )

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each column in the input."""
        return {self.column: 1.0} if self.column is not None else dict(self.sum or {})


class OutputTable(Table):
    """Key [[outputs]]: an FMU output and its measurement, which may have times of its own and gaps.

    Attributes:
        name: the output of the FMU.
        unit: unit of the column, and of all results.
        fmu_unit: unit that the FMU's equations count in, where the FMU declares none.
        file: file in the folder `data`: CSV, Parquet, or a sheet of a workbook, as "runs.xlsx#Sheet"; an
            output with limits needs none.
        column: column of the file; an empty cell is a gap.
        replicates: columns of replicates, in place of `column`: their mean is compared. Its standard
            uncertainty is `uncertainty`, else what they differ by, by the square root of their number.
        mean_over_s: length of the interval that each sample is the mean over; without it, a sample is the
            value of a moment. Samples whose interval is not within the window are left out.
        sum_over_s: the same of sums, as kWh of an hour for an output in W: `unit` and `uncertainty` are those
            of the sum; results are means, in the FMU's unit.
        starts_at: "first" where the column is a counter, as of energy, that had run before: what it counts
            from its first value in the window on is compared.
        wraps_at: where such a counter begins at 0 again. [unit]
        on_change: whether a value is recorded only when it changes; it then holds until the next one.
        mean_stamp: what of the interval the time of a sample is: its end, begin or centre.
        uncertainty: standard uncertainty of the sensor; without one, of the limits. [unit]
        uncertainty_column: column of the file with the standard uncertainty of each sample, in place of
            `uncertainty`. [unit]
        uncertainty_share: part of the measured value that each sample is uncertain by, beside `uncertainty`.
            [1]
        error_lasts_s: how long an error of the sensor lasts, where its errors are autocorrelated: it weighs
            priors and intervals, and changes no error.
        correlation_time_s: the same for the error as well: the correlation time of autoregressive noise, of
            which differences are freed before they are squared.
        weight: share of the error relative to the other outputs. [1]
        normalize: what differences count relative to, in place of the uncertainty: the range of the measured
            values, the size of their mean, or a number; in all outputs or in none. [unit]
        at_least: lower limit; what a simulation lies below counts as a difference. [unit]
        at_most: upper limit; what a simulation lies above counts as a difference. [unit]
        loss: how differences count: their squares, or less where they are large, against outliers.
        loss_scale: difference from which on a robust loss counts less; without it, twice the uncertainty.
            [unit]
        accepted: band outside of which a simulation has failed. [unit]
    """

    name: Name
    unit: Line
    fmu_unit: Name | None = None
    file: Name | None = None
    column: Name | None = None
    replicates: Annotated[list[Name], Field(min_length=2)] | None = None
    mean_over_s: Positive | None = None
    sum_over_s: Positive | None = None
    starts_at: Literal["first"] | None = None
    wraps_at: Positive | None = None
    on_change: bool = False
    mean_stamp: Stamp = "end"
    uncertainty: Positive | None = None
    uncertainty_column: Name | None = None
    uncertainty_share: Positive | None = None
    error_lasts_s: Positive | None = None
    correlation_time_s: Positive | None = None
    weight: Positive = 1.0
    normalize: Literal["range", "mean"] | Positive | None = None
    at_least: Finite | None = None
    at_most: Finite | None = None
    loss: Literal["squares"] | LossKind = "squares"
    loss_scale: Positive | None = None
    accepted: Pair | None = None

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        if self.accepted is not None and not self.accepted[0] < self.accepted[1]:
            low, high = self.accepted
            raise ValueError(f"accepted = [{low:g}, {high:g}] holds nothing; give the lower value first")
        self._check_uncertainty()
        if self.replicates is not None and self.column is not None:
            raise ValueError("replicates says what column says; drop one of them")
        missing = [key for key in ("file", "column") if getattr(self, key) is None]
        if self.replicates is not None:
            missing = missing[:-1]
        if len(missing) == 1:
            raise ValueError(f"key {missing[0]} is missing; add it")
        if missing:
            self._check_limits_alone()
        if self.at_least is not None and self.at_most is not None and not self.at_least < self.at_most:
            raise ValueError(
                f"at_least = {self.at_least:g} is not below at_most = {self.at_most:g}; correct one of them"
            )
        if self.correlation_time_s is not None and self.error_lasts_s is not None:
            raise ValueError("correlation_time_s says what error_lasts_s says, and more; drop error_lasts_s")
        if self.correlation_time_s is not None and self.loss != "squares":
            raise ValueError("correlation_time_s beside a robust loss: outliers spoil two samples; drop one")
        self._check_samples()
        if self.loss_scale is not None and self.loss == "squares":
            raise ValueError('loss_scale has no robust loss; add loss = "huber" or "soft-l1", or drop it')
        return self

    def _check_samples(self) -> None:
        """Check that it is said once what a sample stands for."""
        kinds = {
            "mean_over_s": self.mean_over_s,
            "sum_over_s": self.sum_over_s,
            "starts_at": self.starts_at,
            "on_change": self.on_change or None,
        }
        said = [key for key, value in kinds.items() if value is not None]
        if len(said) > 1:
            raise ValueError(f"{said[0]} beside {said[1]}: a sample stands for one of them; drop the other")
        _one_length(self)
        if self.wraps_at is not None and self.starts_at is None:
            raise ValueError('wraps_at is of a counter; add starts_at = "first", or drop it')
        if self.sum_over_s is not None or self.starts_at is not None:
            for key in ("at_least", "at_most", "accepted", "loss_scale", "normalize"):
                if getattr(self, key) is not None:
                    raise ValueError(f"{key} beside {said[0]} has no clear unit; drop it")
        if self.starts_at is not None and self.uncertainty_share is not None:
            raise ValueError("uncertainty_share of a counter grows with what it counted before; drop it")

    def _check_uncertainty(self) -> None:
        """Check that it is said once how sure a sample is."""
        if self.replicates is not None:
            for key in ("uncertainty_column", "uncertainty_share", "normalize", "sum_over_s", "starts_at"):
                if getattr(self, key) is not None:
                    raise ValueError(f"{key} beside replicates; write a column of their means instead")
        elif self.uncertainty_column is None and self.uncertainty is None:
            raise ValueError("key uncertainty is missing; add it, or uncertainty_column")
        if self.uncertainty_column is not None:
            for key in ("uncertainty", "uncertainty_share"):
                if getattr(self, key) is not None:
                    raise ValueError(
                        f"uncertainty_column and {key} both give the uncertainty; remove one of them"
                    )
        if self.normalize is not None and (self.uncertainty_column or self.uncertainty_share):
            raise ValueError(
                "normalize replaces uncertainties; remove it, or the uncertainties of single samples"
            )

    def _check_limits_alone(self) -> None:
        """Check an output that is not measured."""
        if not self.has_limits:
            raise ValueError("keys file and column are missing; add them, or a limit: at_most = ...")
        of_samples = ("uncertainty_column", "uncertainty_share", "sum_over_s", "starts_at", "on_change")
        for key in ("error_lasts_s", "correlation_time_s", "mean_over_s", *of_samples):
            if getattr(self, key) not in (None, False):
                raise ValueError(f"{key} is of a sensor, and nothing is measured; drop it")
        if isinstance(self.normalize, str):
            raise ValueError(
                f'normalize = "{self.normalize}" is of measured values, and there are none; write a number'
            )

    @property
    def source(self) -> tuple[str, str] | None:
        """File and column of the measurement, None where there is none."""
        column = f"the mean for {self.name}" if self.replicates else self.column
        return None if self.file is None or column is None else (self.file, column)

    @property
    def columns(self) -> list[tuple[str, str]]:
        """File and column of all that is read for it."""
        named = filter(None, (self.column, self.uncertainty_column, *(self.replicates or ())))
        return [] if self.file is None else [(self.file, column) for column in named]

    @property
    def interval(self) -> tuple[float, float]:
        """From when on and until when a sample says something, relative to its time. [s]."""
        return _interval(self.mean_over_s, self.mean_stamp)

    @property
    def has_limits(self) -> bool:
        """Whether the output has to stay within limits."""
        return self.at_least is not None or self.at_most is not None

    def robust_loss(self, uncertainty: float) -> RobustLoss | None:
        """Return the robust loss of a sensor with an uncertainty [unit], None for squares."""
        if self.loss == "squares":
            return None
        return RobustLoss(self.loss, self.loss_scale or USUAL_SCALE * uncertainty)


class PriorTable(Table):
    """Key prior of a parameter: where it is expected (`about`, else its estimate), and how surely.

    Two thirds of the probability lie `within` around it for a linear scale, in the parameter's unit, or a
    factor of `within_factor` around it for a logarithmic one.

    Attributes:
        about: the expected value; without it, the estimate. [unit]
        within: for a linear scale: standard deviation. [unit]
        within_factor: for a logarithmic scale: standard deviation as a factor. [1]
    """

    about: Finite | None = None
    within: Positive | None = None
    within_factor: Positive | None = None


class ParameterTable(Table):
    """Key [[parameters]]: a parameter to calibrate, and what is known about it beforehand.

    Attributes:
        name: the parameter of the FMU, or an input that is an unknown constant.
        estimate: a usual value, for priors and fixed parameters. [unit]
        lower: lower bound. [unit]
        upper: upper bound. [unit]
        unit: unit of its values.
        scale: whether it is searched in its value or in the logarithm of it.
        description: what it means, for the reader.
        prior: what is known beforehand.
        per_experiment: whether each experiment has a value of its own.
    """

    name: Name
    estimate: Finite | None = None
    lower: Finite
    upper: Finite
    unit: str = "1"
    scale: Scale = "linear"
    description: str = ""
    prior: PriorTable | None = None
    per_experiment: bool = False

    @model_validator(mode="after")
    def _prior_fits(self) -> Self:
        if self.prior is None:
            return self
        within, factor = self.prior.within, self.prior.within_factor
        right, wrong, needed = (within, factor, "within, in its unit, and no within_factor")
        if self.scale == "log":
            right, wrong, needed = (factor, within, "within_factor, like 1.5, and no within")
        if right is None or wrong is not None:
            raise ValueError(f'prior does not fit scale = "{self.scale}"; write {needed}')
        if self.prior.about is None and self.estimate is None:
            raise ValueError("prior has neither about nor an estimate to lie around; add about = ...")
        return self

    def to_parameter(self) -> Parameter:
        """Return the parameter.

        Raises:
            InputError: If its numbers contradict each other.
        """
        belief = None
        if self.prior is not None:
            centre = self.estimate if self.prior.about is None else self.prior.about
            width = self.prior.within or self.prior.within_factor
            assert centre is not None, "its validator saw to that"
            assert width is not None, "its validator saw to that"
            belief = Belief(centre, width)
        return Parameter(**self.model_dump(exclude={"prior", "per_experiment"}), prior=belief)


class FirstMeasured(Table):
    """Value of [fixed]: the measured value of an output at the start of the simulation.

    Attributes:
        first_measured: name of the output. Where the FMU declares no unit for the parameter, that of the
            output counts: its own, or `fmu_unit`.
    """

    first_measured: Name


class ValueWithUnit(Table):
    """Value of [fixed]: a number with its unit, converted to the one that the FMU declares.

    Attributes:
        value: the number. [unit]
        unit: its unit.
    """

    value: Finite
    unit: Name


FixedValue = bool | _Whole | Finite | str | FirstMeasured | ValueWithUnit


class SimulationTable(Table):
    """Key [simulation]: how patiently simulations are run; changes no answer. See ExecutionPolicy.

    Attributes:
        timeout_s: longest simulation; without it, 100 times the slowest one before, and at least a minute.
            `inf` stops none.
        retries: how often a failed simulation is repeated. [1]
        max_failed_share: share of failed simulations beyond which a command stops. [1]
        max_workers: most processes at once, for instance as many as there are licences. [1]
    """

    timeout_s: Annotated[float, Field(gt=0, allow_inf_nan=True)] | None = None
    retries: Annotated[int, Field(ge=0)] = 1
    max_failed_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    max_workers: Annotated[int, Field(ge=1)] | None = None


class ReferenceTable(_WindowTable):
    """Key [[references]]: a mean squared error that is known for a window, to judge results by.

    Attributes:
        window_d: begin and end of the window.
        window_s: the same in seconds.
        label: where the error comes from.
        mse: the mean squared error; where an output has a robust loss, the mean loss. [unit²]
        target: whether calls to this error are counted.
    """

    label: Name
    mse: Positive
    target: bool = False


class NamedTable(BaseModel):
    """A table with a name, whose other keys are read once it is whole."""

    model_config = ConfigDict(extra="allow", strict=True)

    name: Name


class ExperimentTable(Table):
    """Key [[experiments]]: one of several recordings that the same parameters explain.

    What it does not say is as in the rest of the file.

    Attributes:
        name: name of the experiment; its outputs and own parameters are called `<name>@<experiment>`.
        held_out: whether it is not calibrated, to try the result on.
        weight: share of its outputs' error relative to the other experiments'. [1]
        fmu: another FMU with the same parameters, from the folder of the case file.
        interface: how that FMU is run.
        data: another folder of recordings, from the folder of the case file.
        time: keys of [time] that differ.
        inputs: keys of [[inputs]] that differ, by `name`.
        outputs: the outputs of this experiment, and what differs of their keys; without it, all.
        fixed: values of [fixed] that differ.
        shared: parameters of the FMU that have the value of one of [[parameters]] here, by the name of the
            latter, as `U = "U_site_A"`: experiments that name it share it. The FMU need not know that name.
    """

    name: Label
    held_out: bool = False
    weight: Positive = 1.0
    fmu: Name | None = None
    interface: Interface | None = None
    data: Line | None = None
    time: dict[str, Any] = {}
    inputs: list[NamedTable] = []
    outputs: list[NamedTable] = []
    fixed: dict[str, FixedValue] = {}
    shared: dict[str, Name] = {}


class CaseFile(Table):
    """A whole case.toml.

    Attributes:
        schema: version of this form.
        name: name of the case, part of every label.
        title: one line for reports.
        note: printed wherever the numbers appear.
        fmu: the FMU, from the folder of the case file.
        interface: how the FMU is run.
        relative_tolerance: of the FMU's solver; without it, the FMU's own. [1]
        data: folder of the recordings, from the folder of the case file.
        data_origin: where missing recordings come from; part of the error message.
        time_column: column of the times; without it, `time_s` or `time`.
        timezone: zone of timestamps without an offset, as "Europe/Berlin"; without it, they
            have no summer time.
        time_format: how timestamps are written, in codes of Python's strptime, as "%m/%d %H:%M:%S"; without
            it, ISO 8601 or day.month.year.
        year: year of timestamps that have none; without it, one of 365 days.
        decimal: sign before the decimals in the CSV files, whose numbers may then have signs of thousands;
            without it, it is found out.
        time: the window, steps and validation.
        inputs: inputs that recordings drive.
        outputs: outputs that are compared with measurements.
        parameters: parameters that are calibrated.
        fixed: values of other parameters, inputs and initial states, by name.
        tied: parameters that follow from others, by name: `R2 = "3 * R1"`, in SI units.
        constraints: pairs of calibrated parameters, as "R1 < R2", and sums of them, as "fA + fB <= 0.9";
            every simulation keeps them.
        simulation: time-out and retries.
        references: known errors.
        experiments: several recordings instead of one.
    """

    # Later schemas must say so, else an old program would read a new file wrongly.
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: Label
    title: str = ""
    note: str = ""
    fmu: Name
    interface: Interface = "co-simulation"
    relative_tolerance: Annotated[float, Field(gt=0, lt=1)] | None = None
    data: Line = "."
    data_origin: str = ""
    time_column: Name | None = None
    timezone: Name | None = None
    time_format: Name | None = None
    year: Annotated[int, Field(ge=1, le=9998)] | None = None
    decimal: Literal[".", ","] | None = None
    time: TimeTable
    inputs: list[InputTable] = []
    outputs: Annotated[list[OutputTable], Field(min_length=1)]
    parameters: Annotated[list[ParameterTable], Field(min_length=1)]
    fixed: dict[str, FixedValue] = {}
    tied: dict[str, Line] = {}
    constraints: list[Line] = []
    simulation: SimulationTable = SimulationTable()
    references: list[ReferenceTable] = []
    experiments: list[ExperimentTable] = []

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        zone_named(self.timezone)
        self._check_stamps()
        tables = {"inputs": self.inputs, "outputs": self.outputs, "parameters": self.parameters}
        declared = Counter(f"{key}[{table.name}]" for key in tables for table in tables[key])
        for key, n in declared.items():
            if n > 1:
                raise ValueError(f"{key} is declared {n} times; keep one")
        if not any(one.source for one in self.outputs):
            raise ValueError("outputs: none is measured; give one of them file and column")
        plain = [one.name for one in self.outputs if one.normalize is None]
        if 0 < len(plain) < len(self.outputs):
            raise ValueError(
                f"outputs[{plain[0]}] has no normalize and others have; give it to all of them, or to none"
            )
        for name in self.fixed:
            if f"parameters[{name}]" in declared:
                raise ValueError(
                    f"fixed.{name}: {name} is both in [[parameters]] and under [fixed]; remove one of them"
                )
        for name in self.tied:
            if name in self.fixed or f"parameters[{name}]" in declared:
                also = "[fixed]" if name in self.fixed else "[[parameters]]"
                raise ValueError(f"tied.{name}: {name} is both under [tied] and {also}; remove one of them")
        return self

    def is_per_experiment(self, name: str) -> bool:
        """Say whether a parameter has a value of its own in each experiment."""
        return next(one for one in self.parameters if one.name == name).per_experiment

    @property
    def stamps(self) -> StampForm | None:
        """How timestamps are written, None for the usual forms."""
        if self.time_format is None:
            return None
        return StampForm(self.time_format) if self.year is None else StampForm(self.time_format, self.year)

    def _check_stamps(self) -> None:
        """Check what says how timestamps are written."""
        form = self.stamps
        if form is not None:
            try:
                form.check()
            except ValueError as error:
                raise ValueError(f'time_format = "{form.text}" {error}') from None
        if self.year is not None and (form is None or form.has_year):
            raise ValueError(
                f'year = {self.year} is of a time_format without a year, like "%m/%d %H:%M"; drop it'
            )
