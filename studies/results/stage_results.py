"""What each stage comes to: one frozen dataclass, which terminal, page, MLflow and programs read alike."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from studies.calibration.recorder import History
from studies.calibration.uncertainty.findings import Compensation
from studies.calibration.uncertainty.identifiability import Pair, Ridge
from studies.calibration.uncertainty.noise import Noise
from studies.results.best_mean import MeanPart, shortened_model
from studies.results.declaration import CROSS_VALIDATED
from studies.results.saved import WITH_ARRAYS, Error

ADAPTIVE = "adaptive"
"""What an adaptive calibration is called; one by the paper's method has the name of its size, as n0064."""
Setting = bool | int | float | str | None


@dataclass(frozen=True)
class OutputFit:
    """How one simulated output differs from its measurement.

    Attributes:
        n_samples: Samples compared.
        rmse: Root mean square difference. [output's unit]
        bias: Mean of simulated minus measured. [output's unit]
        cv_rmse: rmse over the size of the mean measured value; None where that says nothing: for
            temperatures, whose zero is a convention, and for means of zero. [1]
        nmbe: bias over its size, positive where the model is too high; None likewise. [1]
        nrmse: rmse over the range of the measured values; None where they are all the same, or none. [1]
    """

    n_samples: int
    rmse: float
    bias: float
    cv_rmse: float | None
    nmbe: float | None
    nrmse: float | None = None


@dataclass(frozen=True)
class ValidatedPoint:
    """One parameter set on both periods.

    Attributes:
        mse_window: Error over the calibrated window; None where the simulation does not report it, or failed.
            [first output's unit squared]
        mse: Error over the validation period, None where the simulation failed. [first output's unit squared]
        failure: Why it failed, "" when it did not.
        outputs: The fit by the outputs' names; empty where the simulation failed.
    """

    mse_window: float | None
    mse: float | None
    failure: str
    outputs: dict[str, OutputFit]


@dataclass(frozen=True)
class SimulatedSets:
    """The sets of simulations behind the surrogates, by name: train, validation, test.

    Attributes:
        n: Rows of each set.
        n_failed: Failed rows of each set.
        first_failures: Up to three reasons.
        files: Place of each set in the project.
        digests: SHA-256 of each set's rows.
        store: Place of the store that holds the rows.
        n_reused: Rows that were stored before.
    """

    n: dict[str, int]
    n_failed: dict[str, int]
    first_failures: tuple[str, ...]
    files: dict[str, str]
    digests: dict[str, str]
    store: str
    n_reused: int

    @property
    def has_failures(self) -> bool:
        """Whether a row failed."""
        return any(self.n_failed.values())


@dataclass(frozen=True)
class TunedSize:
    """What tuning came to for one training-set size; as JSON values it is what programs read.

    Attributes:
        label: Label of the study.
        case: Name of the case.
        n_train: Size of the training set.
        study: Name of the Optuna study.
        surrogate: Named form of the surrogate.
        is_baseline: Whether it is the PCA + GP that is fitted for comparison.
        unit: Of the errors.
        n_planned: Trials the study shall have.
        n_trials: Trials that have ended: complete, pruned and failed ones.
        n_complete: Trials trained to their end.
        n_pruned: Trials stopped early.
        n_failed: Trials that failed.
        n_running: Trials that run now.
        n_waiting: Trials that wait.
        n_proposed: Trials that the sampler proposed from results.
        wall_s: Training time of all trials together. [s]
        to_go_s: Training time of the trials to come, on one core; None before the first trial. [s]
        trials_per_h: Trials per hour of training, without those added by hand; None before the first. [1/h]
        gain: Part of the default configuration's validation MAE that tuning took away; None if unknown. [1]
        gain_deviation: Its standard deviation from seed to seed; None where it was not confirmed. [1]
        n_seeds: Further seeds of both, whose means the gain compares; 0 where it was not confirmed.
        trial: Number of the best trial; None without a complete one, as all that follows.
        run_id: MLflow's run of the best trial.
        model_uri: Address by which MLflow loads the best surrogate; None for a baseline, too.
        model: What the best surrogate is: "trial 5", or the mean of several.
        parts: What a mean is made of, with the errors of each; none of a trial alone.
        params: Hyperparameters of the best trial; none where it is no part of the mean.
        mae: Test MAE of the best trial, or the cross-validated one. [unit]
        p90: 90th percentile of its absolute errors there. [unit]
        metrics: All errors of the best trial by name. [unit]
        baseline: Errors of PCA + GP on the same sets by name; empty without. [unit]
        folds: Parts of the training rows that judged in turn; 0 where a validation and a test set did.
        n_carried: Trials of its latest study that were carried over from an earlier one, not trained again.
    """

    label: str
    case: str
    n_train: int
    study: str
    surrogate: str
    is_baseline: bool
    unit: str
    n_planned: int
    n_trials: int
    n_complete: int
    n_pruned: int
    n_failed: int
    n_running: int
    n_waiting: int
    n_proposed: int
    wall_s: float
    to_go_s: float | None
    gain: float | None
    gain_deviation: float | None = None
    n_seeds: int = 0
    trials_per_h: float | None = None
    trial: int | None = None
    run_id: str | None = None
    model_uri: str | None = None
    model: str = ""
    parts: tuple[MeanPart, ...] = ()
    params: Mapping[str, Any] = field(default_factory=dict)
    mae: float | None = None
    p90: float | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    baseline: Mapping[str, float] = field(default_factory=dict)
    folds: int = 0
    n_carried: int = 0

    @property
    def judged_by(self) -> str:
        """First part of the names of the errors that are shown."""
        return CROSS_VALIDATED if self.folds else "test"

    @property
    def short_model(self) -> str:
        """What the best surrogate is, for a cell of a table."""
        return shortened_model(self.model)

    @property
    def n_all(self) -> int:
        """Trials that it has or shall have."""
        return max(self.n_planned, self.n_trials + self.n_running + self.n_waiting)


@dataclass(frozen=True)
class Tuned:
    """The best surrogate of each training-set size.

    Attributes:
        studies: One per size.
    """

    studies: tuple[TunedSize, ...]


@dataclass(frozen=True)
class Reported:
    """The page of a study.

    Attributes:
        index: Its place in the project.
    """

    index: str


@dataclass(frozen=True)
class LargestSample:
    """The sample of an output that differs most, where it stands alone: it may be wrong.

    Attributes:
        difference: Simulated minus measured. [output's unit]
        at: Its time, as the recording writes it.
        times_median: Its size over the median size of the output's differences; None where that is 0. [1]
    """

    difference: float
    at: str
    times_median: float | None


@dataclass(frozen=True)
class Fit:
    """How one output differs from its measurement over the calibrated window.

    Attributes:
        rmse: Root mean square difference; of an output with limits alone, of what lies beyond them. [output's
            unit]
        uncertainty: That of its sensor; None where it is not declared. [output's unit]
        share_within: Share of the samples that differ by no more; None likewise. [1]
        nrmse: rmse over the range of the measured values; None where they are all the same, or none. [1]
        cv_rmse: rmse over the size of their mean, as in the validation; None for temperatures, for means of
            zero and where nothing is measured. [1]
        largest_excess: How far it lies beyond its limits at most, below 0 under the lower one; None without
            limits. [output's unit]
        share_beyond: Share of the output times at which it does; None likewise. [1]
        largest: The sample that differs most, where it stands alone; None where none does.
        of_each_sample: Whether each sample has an uncertainty of its own, which `share_within` is of.
    """

    rmse: Error
    uncertainty: float | None = None
    share_within: float | None = None
    nrmse: float | None = None
    cv_rmse: float | None = None
    largest_excess: float | None = None
    share_beyond: float | None = None
    largest: LargestSample | None = None
    of_each_sample: bool = False


@dataclass(frozen=True)
class Determined:
    """What the data determine of a calibrated point.

    Attributes:
        spread: Standard deviation of each parameter, as a share of its range. [1]
        open: Parameters that the data leave open.
        pairs: Parameters of which one makes up for the other.
        ridges: Groups of parameters that make up for each other, and how many of each are free.
    """

    spread: dict[str, float]
    open: tuple[str, ...]
    pairs: tuple[Pair, ...]
    ridges: tuple[Ridge, ...] = ()


@dataclass(frozen=True)
class EquationsFound:
    """What became of the state equations that a calibration looked for.

    Attributes:
        n_states: States of the FMU.
        n_calls: Calls that the equations chose.
        misfit: Of the equations to the derivatives; None where none were learnt. [1]
        hidden_inputs: Variables inside the FMU that act as inputs.
        error_at_best: Difference of equations and best simulation as a share of its error; None where they
            are not believed. [1]
        are_believed: Whether their last predictions were right.
        why_not: Why none were learnt, None where they were.
        without_effect: Parameters that changed nothing in any simulation.
        n_alone: Simulations of single experiments that they were learnt from before any whole row.
        is_given_up: Whether their last proposals gained less than they err by.
    """

    n_states: int
    n_calls: int
    misfit: float | None
    hidden_inputs: tuple[str, ...]
    error_at_best: float | None
    are_believed: bool
    why_not: str | None
    without_effect: tuple[str, ...]
    n_alone: int = 0
    is_given_up: bool = False


@dataclass(frozen=True)
class Held:
    """A parameter of which something was known before.

    Attributes:
        about: What it was expected to be. [parameter's unit]
        moved_deviations: How far it was moved, in standard deviations of the prior. [1]
        within_factor: Standard deviation as a factor; None on a linear scale. [1]
        within: Standard deviation; None on a logarithmic scale. [parameter's unit]
    """

    about: float
    moved_deviations: float
    within_factor: float | None = None
    within: float | None = None


@dataclass(frozen=True)
class PriorFound:
    """How far a calibrated point lies from what was known.

    Attributes:
        weight: What one standard deviation weighs. [first output's unit squared]
        n_independent: Independent samples that the measurement is worth.
        penalty: Of all priors together. [first output's unit squared]
        parameters: Each parameter of which something was known.
    """

    weight: float
    n_independent: float
    penalty: float
    parameters: dict[str, Held]


@dataclass(frozen=True)
class Validated:
    """How parameter sets do on a period that was not calibrated.

    Attributes:
        period_d: The period. [d]
        points: The parameter sets by name, the calibrated one last. Each took one simulation.
    """

    period_d: tuple[float, float]
    points: dict[str, ValidatedPoint]

    @property
    def final(self) -> ValidatedPoint:
        """The calibrated parameter set."""
        return list(self.points.values())[-1]


SURROGATE_FIELDS = ("study", "trial", "model", "run_id", "params", "errors", "weights_sha256")
"""Fields of `Screened` that say which surrogate screened."""


@dataclass(frozen=True)
class Screened:
    """The point that the surrogate chose, and the surrogate.

    Attributes:
        theta: The point. [per parameter]
        mse_surrogate: Its error by the surrogate. [first output's unit squared]
        mse: Its error by the physical model, infinite where that failed. [first output's unit squared]
        stop_reason: Why the screening ended.
        study: Optuna study of the surrogate.
        trial: Number of its trial.
        model: What it is: "trial 5", or the mean of several.
        run_id: MLflow's run of the trial.
        params: Its hyperparameters.
        errors: Its errors by name. [first output's unit]
        weights_sha256: Of its weights.
    """

    theta: dict[str, float]
    mse_surrogate: Error
    mse: Error
    stop_reason: str
    study: str = ""
    trial: int = 0
    model: str = ""
    run_id: str = ""
    params: dict[str, Setting] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    weights_sha256: str = ""

    @property
    def gap(self) -> float:
        """Error by the physical model minus that by the surrogate. [first output's unit squared]."""
        return self.mse - self.mse_surrogate


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration, by the adaptive method or by the paper's: screened on a surrogate, polished on the FMU.

    Attributes:
        case: Name of the case.
        method: "adaptive" or "paper".
        n_train: Size of the surrogate's training set; 0 for an adaptive one.
        seed: Seed of all draws.
        settings: How it searched.
        theta: Calibrated parameters. [units]
        units: Their units.
        output_unit: Unit of the first output.
        mse: Final error, infinite where no simulation succeeded. [first output's unit squared]
        stop_reason: Why it ended.
        converged: Whether a tolerance, or the target, ended it.
        left: Why it stopped without having converged; "" where it has.
        outputs: How each output differs from its measurement.
        ledger: Model calls by purpose, and their totals.
        n_rounds: Rounds of simulations of an adaptive one.
        n_warm_start: Stored simulations that it started from; they are none of its calls.
        n_failed: Rows that failed.
        first_failure: Why the first one failed.
        n_simulated: Rows that were not stored before.
        expected_gain: Part of the error that an adaptive one expected to gain when it ended. [1]
        without_effect: Parameters on which the error hardly depends.
        state_equations: What became of state equations; None where none were looked for.
        determined_by_data: What the data determine; None where too little is known for that.
        prior: What was known before; None for nothing.
        validation: How it does on the validation period; None without one.
        screening: What the surrogate chose; None for an adaptive one.
        time: Output times. Shape (t,). [s]
        y: The model at the calibrated parameters. Shape (t, k). [per output]
        history_calls: Model calls so far, as the paper counts them. Shape (h,).
        history_mse: Best error after so many calls. Shape (h,). [first output's unit squared]
        y_screened: The model at the screened point. Shape (t, k). [per output]
        validation_time: Output times of the validation period. Shape (v,). [s]
        validation_y: The model there. Shape (v, k). [per output]
        validation_y_screened: The model there at the screened point. Shape (v, k). [per output]
        error_name: What its errors are, which all fields name `mse`: "MSE", "mean loss" where an output
            has a robust loss, or "whitened MSE" where one has a correlation time.
        start_theta: The stored simulations that it started from. Shape (n, p). [per parameter]
        start_watched: Which of them are stored with the model's states. Shape (n,).
        n_repeated: Simulations that were repeated to see whether they are the same again; none of its calls.
        is_random: Whether the best simulation was another one when it was repeated in a new process.
        has_own_processes: Whether each simulation had a process of its own because the FMU does not forget
            one simulation before the next.
    """

    __pydantic_config__ = WITH_ARRAYS

    case: str
    method: Literal["adaptive", "paper"]
    n_train: int
    seed: int
    settings: dict[str, Setting]
    theta: dict[str, float]
    units: dict[str, str]
    output_unit: str
    mse: Error
    stop_reason: str
    converged: bool
    outputs: dict[str, Fit]
    ledger: dict[str, int]
    n_failed: int
    first_failure: str | None
    n_simulated: int
    time: FloatArray
    y: FloatArray
    history_calls: IntArray
    history_mse: FloatArray
    left: str = ""
    n_rounds: int | None = None
    n_warm_start: int | None = None
    expected_gain: float | None = None
    without_effect: tuple[str, ...] = ()
    state_equations: EquationsFound | None = None
    determined_by_data: Determined | None = None
    prior: PriorFound | None = None
    validation: Validated | None = None
    screening: Screened | None = None
    y_screened: FloatArray | None = None
    validation_time: FloatArray | None = None
    validation_y: FloatArray | None = None
    validation_y_screened: FloatArray | None = None
    error_name: str = "MSE"
    start_theta: FloatArray | None = None
    start_watched: BoolArray | None = None
    n_repeated: int = 0
    is_random: bool = False
    has_own_processes: bool = False

    @property
    def has_failures(self) -> bool:
        """Whether a row failed."""
        return self.n_failed > 0

    @property
    def is_adaptive(self) -> bool:
        """Whether it needed no surrogate."""
        return self.method == ADAPTIVE

    @property
    def shown_name(self) -> str:
        """What readers call it."""
        return ADAPTIVE if self.is_adaptive else f"n = {self.n_train}"

    @property
    def final(self) -> str:
        """What its last point is called."""
        return "calibrated" if self.is_adaptive else "polished"

    @property
    def believes_equations(self) -> bool:
        """Whether it believed in state equations when it ended."""
        return self.state_equations is not None and self.state_equations.are_believed

    @cached_property
    def point(self) -> FloatArray:
        """The calibrated parameters. Shape (p,). [per parameter]."""
        return np.array(list(self.theta.values()))

    @property
    def history(self) -> History:
        """Best error over model calls, as the paper counts them."""
        return History(self.history_calls, self.history_mse)

    @property
    def n_calls_paper(self) -> int:
        """Model calls in the paper's count."""
        return self.ledger.get("total_paper", 0)

    @property
    def n_calls(self) -> int:
        """All model calls, those for validation and test sets included."""
        return sum(n for what, n in self.ledger.items() if what.startswith("n_"))


@dataclass(frozen=True)
class Known:
    """What is known of one parameter.

    Attributes:
        calibrated: Its calibrated value. [parameter's unit]
        linear: Linearised interval. [parameter's unit]
        interval: Interval of the posterior. [parameter's unit]
        median: Median of the posterior. [parameter's unit]
        known: "determined", "narrowed", "open" or "prior".
    """

    calibrated: float
    linear: tuple[float, float]
    interval: tuple[float, float]
    median: float
    known: str


@dataclass(frozen=True)
class SampleFound:
    """A sample of equally good parameter sets.

    Attributes:
        n: Sets that were simulated.
        n_effective: Sets of equal weight that these are worth.
        is_trusted: Whether that is enough.
        best_mse: Lowest error of all rows that are known. [first output's unit squared]
        best_theta: Where. [per parameter]
    """

    n: int
    n_effective: float
    is_trusted: bool
    best_mse: float
    best_theta: dict[str, float]


@dataclass(frozen=True)
class Covered:
    """How the bands of one output lie over its measurement.

    Attributes:
        share_within_simulated: Share of the samples within the band of the simulations. [1]
        share_within_predictive: The same with noise. [1]
    """

    share_within_simulated: float
    share_within_predictive: float


@dataclass(frozen=True)
class Cost:
    """Model calls of an uncertainty.

    Attributes:
        n_differences: For the differences.
        n_taught: To teach the surrogate.
        n_sample: Of the sample.
        total: All of them.
        n_warm_start: Stored simulations that taught the surrogate too; no calls.
        by_equations: Whether state equations gave all but the sample.
    """

    n_differences: int
    n_taught: int
    n_sample: int
    total: int
    n_warm_start: int
    by_equations: bool


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How sure a calibration is.

    Attributes:
        calibration: Name of the calibration.
        seed: Seed of all draws.
        max_calls: Most model calls that were allowed.
        mse: Error of the calibration. [first output's unit squared]
        level: Probability of intervals and bands. [1]
        noise: The noise model with its numbers.
        sensor: Uncertainty of the first output's sensor; None where it is not declared. [output's unit]
        has_prior: Whether something was known before.
        parameters: What is known of each parameter.
        pairs: Parameters that compensate each other, the clearest first.
        null_directions: Combinations of parameters that change no output near the point, in words.
        sample: Equally good parameter sets.
        outputs: How the bands lie over each measured output.
        ledger: Model calls.
        n_failed: Rows that failed.
        first_failure: Why the first one failed.
        n_simulated: Rows that were not stored before.
        time: Output times. Shape (t,). [s]
        sample_theta: The sample. Shape (n, p). [per parameter]
        weights: What each counts; sum 1. Shape (n,). [1]
        particles_theta: Points of equal weight by the surrogate. Shape (c, p). [per parameter]
        simulated: Band of the simulated outputs. Shape (2, t, k). [per output]
        predictive: Band of a measurement. Shape (2, t, k). [per output]
    """

    __pydantic_config__ = WITH_ARRAYS

    calibration: str
    seed: int
    max_calls: int
    mse: float
    level: float
    noise: Noise
    sensor: float | None
    has_prior: bool
    parameters: dict[str, Known]
    pairs: tuple[Compensation, ...]
    null_directions: tuple[str, ...]
    sample: SampleFound
    outputs: dict[str, Covered]
    ledger: Cost
    n_failed: int
    first_failure: str | None
    n_simulated: int
    time: FloatArray
    sample_theta: FloatArray
    weights: FloatArray
    particles_theta: FloatArray
    simulated: FloatArray
    predictive: FloatArray

    @property
    def has_failures(self) -> bool:
        """Whether a row failed."""
        return self.n_failed > 0

    @property
    def linear(self) -> FloatArray:
        """Linearised intervals. Shape (2, p). [per parameter]."""
        return np.array([one.linear for one in self.parameters.values()]).T

    @property
    def interval(self) -> FloatArray:
        """Intervals of the posterior, NaN where its sample is not trusted. Shape (2, p). [per parameter]."""
        interval = np.array([one.interval for one in self.parameters.values()]).T
        return interval if self.sample.is_trusted else np.full_like(interval, np.nan)

    @property
    def point(self) -> FloatArray:
        """The calibrated parameters that it is about. Shape (p,). [per parameter]."""
        return np.array([one.calibrated for one in self.parameters.values()])


@dataclass(frozen=True, eq=False)
class Prediction:
    """A calibrated model with other inputs.

    Attributes:
        calibration: Name of the calibration.
        inputs: Place of the recording that drove it.
        table: Place of the CSV file.
        output_names: Names of the k outputs.
        output_units: Their units.
        level: Probability of the bands; None without an uncertainty of this calibration. [1]
        n_sample: Parameter sets that the bands were made of.
        n_failed: Those whose simulation failed.
        time: Output times. Shape (t,). [s]
        y: Outputs of the calibrated parameters. Shape (t, k). [per output]
        simulated: Band of the simulated outputs. Shape (2, t, k). [per output]
        predictive: Band of a measurement. Shape (2, t, k). [per output]
    """

    __pydantic_config__ = WITH_ARRAYS

    calibration: str
    inputs: str
    table: str
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    level: float | None
    n_sample: int
    n_failed: int
    time: FloatArray
    y: FloatArray
    simulated: FloatArray | None = None
    predictive: FloatArray | None = None

    @property
    def has_failures(self) -> bool:
        """Whether a simulation failed."""
        return self.n_failed > 0

    def columns(self) -> Iterator[tuple[str, FloatArray]]:
        """Give the columns of the table with their names."""
        yield "time_s", self.time
        for k, name in enumerate(self.output_names):
            yield name, self.y[:, k]
            for what, band in (("simulated", self.simulated), ("predictive", self.predictive)):
                if band is not None:
                    yield f"{name} {what} low", band[0, :, k]
                    yield f"{name} {what} high", band[1, :, k]
