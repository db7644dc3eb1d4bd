"""Profiles: the budget of a study (sizes, trials, calls, seed), read from TOML and checked at the edge."""

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from pydantic_core import ArgsKwargs

from simulation.errors import InputError
from simulation.foreign_file import PROFILE, parse_toml, read_text
from simulation.foreign_text import MOST_QUOTED, quoted, shortened
from studies.search_space import (
    STRICT,
    Count,
    Positive,
    SearchParameter,
    SearchSpace,
    Value,
    check_fixed,
    check_space,
    space_of,
)

PROFILE_FOLDER = Path(__file__).resolve().parent / "profiles"

Sample = Annotated[int, Field(ge=2, le=1_000_000)]
T = TypeVar("T")
SurrogateName = Annotated[str, Field(pattern=r"^(state-space|refined|paper|pca-gp|[\w.]+:\w+)$")]


@dataclass(frozen=True, config=STRICT)
class DataBudget:
    """How often the physical model is simulated for the surrogate.

    Args:
        n_train: training-set sizes, ascending; one nested design serves all of them. With a budget they may
            be left out: they then follow from it.
        n_validation: simulations that choose epochs and hyperparameters.
        n_test: simulations that only judge.
        folds: parts of the training rows, each of which judges surrogates of the other rows; there is then no
            validation set and no test set.
    """

    n_train: tuple[Annotated[int, Field(ge=4, le=1_000_000)], ...] = ()
    n_validation: Count = 320
    n_test: Count = 320
    folds: Annotated[int, Field(ge=2, le=100)] | None = None

    @property
    def sets(self) -> dict[str, int]:
        """Rows of each set that is simulated."""
        judging = {"validation": self.n_validation, "test": self.n_test} if self.folds is None else {}
        return {"train": max(self.n_train), **judging}

    def __post_init__(self) -> None:
        if list(self.n_train) != sorted(set(self.n_train)):
            raise ValueError(f"n_train must be ascending sizes without repetition, got {list(self.n_train)}")


@dataclass(frozen=True, config=STRICT)
class Budget:
    """How many simulations all stages of a run may take together.

    Args:
        simulations: how many; None for no limit but those of the stages. With a limit surrogates are judged
            by cross-validation, and Sobol indices are the surrogate's.
    """

    simulations: Annotated[int, Field(ge=16, le=1_000_000)] | None = None


@dataclass(frozen=True, config=STRICT)
class SensitivityBudget:
    """What the Sobol indices are estimated from.

    Args:
        model: "surrogate" asks the best surrogate and simulates nothing; "fmu" asks the FMU.
        n_base: base samples of the FMU, a power of two; they take n_base (p + 2) simulations.
        n_resamples: bootstrap draws of the confidence intervals.
    """

    model: Literal["surrogate", "fmu"] = "surrogate"
    n_base: Sample = 256
    n_resamples: Sample = 100

    def __post_init__(self) -> None:
        if self.n_base & (self.n_base - 1):
            raise ValueError(f"n_base must be a power of two, got {self.n_base}")


@dataclass(frozen=True, config=STRICT)
class Confirmation:
    """Further trainings after the trials: the best configurations and the default one with other seeds.

    Args:
        seeds: further trainings of each configuration.
        top: how many of the best configurations are trained again, beside the default one.
    """

    seeds: Annotated[int, Field(ge=2, le=1000)]
    top: Annotated[int, Field(ge=1, le=1000)] = 1


@dataclass(frozen=True, config=STRICT)
class TrialsBudget:
    """How many trials an Optuna study has, and who proposes and prunes them.

    Args:
        n_trials: trials in total, of surrogates per training-set size.
        n_parallel: trials of one study that run side by side. With 1 the same command gives the same trials;
            with more, what the sampler knows when it proposes depends on which trial ends first.
        max_trial_s: longest trial; one that reaches it counts as pruned. [s]
        sampler: a sampler of `optuna.samplers` by its name, or one of an installed package as "module:Class",
            with its arguments.
        pruner: a pruner of `optuna.pruners`, or "CatchUpPruner" (see `studies.tuning.sampler`), by its name,
            or one of an installed package as "module:Class", with its arguments.
        enqueue: configurations that are tried first, of surrogates right after their own.
    """

    n_trials: Count = 100
    n_parallel: Count = 1
    max_trial_s: Positive | None = None
    sampler: dict[str, Any] = Field(default_factory=lambda: {"name": "TPESampler"})
    pruner: dict[str, Any] = Field(default_factory=lambda: {"name": "MedianPruner"})
    enqueue: tuple[dict[str, int | float | str | bool], ...] = ()

    def __post_init__(self) -> None:
        for name in ("sampler", "pruner"):
            if not isinstance(getattr(self, name).get("name"), str):
                raise ValueError(
                    f'{name} is a table with the name of a class, as {name} = {{ name = "..." }}'
                )


@dataclass(frozen=True, config=STRICT)
class TuningBudget(TrialsBudget):
    """How the surrogate is tuned.

    Args:
        n_trials: trials per training-set size, in total.
        surrogate: "state-space" (its decoder knows the inputs), "refined" (networks with the settings that
            were found to help), "paper" (networks as published) or "pca-gp" (PCA and Gaussian processes).
            "module:Class" names a class of an installed package.
        max_epochs: limit of one training; None takes the surrogate's.
        patience: epochs without a better validation error; None takes the surrogate's.
        device: where the trials are trained; "auto" takes CUDA where there is some.
        confirm: further seeds for the best configurations and the default one; None for none. The
            configuration of least mean error is chosen then.
        baseline: whether PCA + GP is also fitted, once per size, for comparison.
        search: the search space; None for the usual one of the surrogate.
        fixed: settings of the surrogate that are not searched, whether or not the search space names them.
    """

    n_trials: Count = Field()
    surrogate: SurrogateName = "refined"
    max_epochs: Count | None = None
    patience: Count | None = None
    device: Literal["auto", "cpu", "cuda"] = "auto"
    sampler: dict[str, Any] = Field(default_factory=lambda: {"name": "TPESampler", "n_startup_trials": 6})
    pruner: dict[str, Any] = Field(default_factory=lambda: {"name": "CatchUpPruner"})
    confirm: Confirmation | None = None
    baseline: bool = True
    search: dict[str, SearchParameter] | None = None
    fixed: dict[str, Value] = Field(default_factory=dict)

    @property
    def space(self) -> SearchSpace:
        """What is searched, and where."""
        space = space_of(self.surrogate, self.search)
        return {name: one for name, one in space.items() if name not in self.fixed}

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fixed(self.surrogate, self.fixed)
        check_space(self.surrogate, self.space, self.enqueue)


@dataclass(frozen=True, config=STRICT)
class ScreeningBudget:
    """Differential evolution on the surrogate.

    Args:
        popsize: population per parameter.
        maxiter: generations.
        margin: part of each parameter's range left out at both ends, in the calibration's coordinates.
    """

    popsize: Count = 8
    maxiter: Count = 200
    margin: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.0


@dataclass(frozen=True, config=STRICT)
class PolishBudget:
    """The search on the physical model that ends a calibration by the paper's method.

    Args:
        max_calls: simulations the polish may ask for.
        ftol: relative change of the cost that ends it.
        optimizer: one of `studies.calibration.optimizers` with its arguments, as `{ name = "SciPyMinimize",
            method = "COBYQA" }`; a search that the surrogate leads unless another one is named.
    """

    max_calls: Count = 400
    ftol: Positive = 1e-4
    optimizer: dict[str, Any] = Field(default_factory=lambda: {"name": "SurrogateSearch"})

    @property
    def settings(self) -> dict[str, Any]:
        """What decides a polish; least squares, which earlier results do not name, is left out."""
        names: dict[str, Any] = {"max_calls": self.max_calls, "ftol": self.ftol}
        if self.optimizer == {"name": "LeastSquaresTRF"}:
            return names
        return names | {f"optimizer.{key}": value for key, value in self.optimizer.items()}


@dataclass(frozen=True, config=STRICT)
class Profile:
    """The budget of a study: a case says what is calibrated, a profile how much may be spent on it.

    Args:
        name: part of every label a user sees.
        note: one sentence on what the budget is for.
        seed: every random draw of a study derives from it.
        data: sizes of the simulated sets.
        sensitivity: budget of the Sobol indices.
        tuning: budget of Optuna's studies.
        screening: budget of differential evolution.
        polish: budget of the polish.
        budget: budget of all stages together.
        schema: version of this form.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=64)]
    data: DataBudget
    tuning: TuningBudget
    sensitivity: SensitivityBudget = Field(default_factory=SensitivityBudget)
    screening: ScreeningBudget = Field(default_factory=ScreeningBudget)
    polish: PolishBudget = Field(default_factory=PolishBudget)
    budget: Budget = Field(default_factory=Budget)
    note: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    schema: Literal[1] = 1

    def __post_init__(self) -> None:
        if self.budget.simulations is None and not self.data.n_train:
            raise ValueError("data.n_train is missing; give sizes, or budget.simulations")

    @property
    def is_budgeted(self) -> bool:
        """Whether the simulations of a run are limited."""
        return self.budget.simulations is not None


@dataclass(frozen=True, config=STRICT)
class ObjectiveProfile:
    """The budget of a study of a user's objective; which function that is no profile can say.

    Args:
        tuning: trials, sampler and pruner.
        name: what a user calls it.
        note: one sentence on what the budget is for.
        seed: every random draw of a study derives from it.
        schema: version of this form.
    """

    tuning: TrialsBudget = Field(default_factory=TrialsBudget)
    name: str = ""
    note: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    schema: Literal[1] = 1


_READER, _READER_OF_OBJECTIVES = TypeAdapter(Profile), TypeAdapter(ObjectiveProfile)


def load_profile(profile: str) -> Profile:
    """Read a profile by its name or its path.

    Raises:
        InputError: no such profile, no TOML, an unknown key or a value out of its range.
    """
    return _read(_READER, _find_profile(profile), f"compare with those in {PROFILE_FOLDER}")


def load_objective_profile(profile: str) -> ObjectiveProfile:
    """Read the profile of an objective by its path.

    Raises:
        InputError: no such profile, no TOML, an unknown key or a value out of its range.
    """
    remedy = "an objective's profile has name, note, seed and [tuning]: its trials, sampler and pruner"
    return _read(_READER_OF_OBJECTIVES, _find_profile(profile), remedy)


def _read(reader: TypeAdapter[T], file: Path, remedy: str) -> T:
    content = parse_toml(read_text(file, PROFILE), str(file))
    try:
        return reader.validate_python(content)
    except ValidationError as error:
        raise InputError(f"{file}: {in_one_line(error)} ({remedy})") from None


def in_one_line(error: ValidationError) -> str:
    """Say the fault a user can best act on: a misspelt key before the missing one that it leaves."""
    faults = error.errors(include_url=False)
    unknown = [fault for fault in faults if fault["type"] == "unexpected_keyword_argument"]
    fault = (unknown or faults)[0]
    key = ".".join(str(part) for part in fault["loc"]) or "the file"
    if unknown:
        return f"unknown key {shortened(key)}; remove or correct it"
    value = "" if isinstance(fault["input"], (dict, ArgsKwargs)) else f" = {quoted(fault['input'])}"
    said = shortened(fault["msg"].removeprefix("Value error, "), 3 * MOST_QUOTED)
    return f"{shortened(key)}{value}: {said}"


def profile_names() -> list[str]:
    """Return the names of the shipped profiles."""
    return sorted(file.stem for file in PROFILE_FOLDER.glob("*.toml"))


def _find_profile(profile: str) -> Path:
    shipped = PROFILE_FOLDER / f"{profile}.toml"
    if profile in profile_names():
        return shipped
    given = Path(profile).expanduser()
    with suppress(OSError):  # a name that is too long
        if given.exists() and not given.is_dir():
            return given
    raise InputError(
        f"there is no profile {quoted(profile)}; give {', '.join(profile_names())} or the path of a "
        "profile file"
    )
